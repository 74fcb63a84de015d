"""Comparison of a run's readings and commands with its limits."""

import pytest

from softarm.daemon.control.records import Inputs, Outputs
from softarm.daemon.logbook.exceeded import exceeded
from softarm.daemon.runtime.offline import Lockstep
from softarm.policies import registry
from softarm.schemas.config import Config, Limits
from softarm.schemas.goals import Goal


class Kept:
    """Recorder that keeps its ticks in memory."""

    def __init__(self) -> None:
        self.ticks: list[tuple[Inputs, Outputs]] = []

    def tick(self, inputs: Inputs, outputs: Outputs, _timing: object) -> None:
        self.ticks.append((inputs, outputs))


@pytest.fixture(scope="module")
def swing() -> list[tuple[Inputs, Outputs]]:
    kept = Kept()
    Lockstep(Config(), registry.load("reach"), recorder=kept).fly(Goal("reach", -0.2, 0.6), 0.0)
    return kept.ticks


def test_a_swing_stays_within_its_limits(swing):
    assert exceeded(swing, Config().limits) == []


@pytest.mark.parametrize(
    ("device", "limit", "says"),
    [
        ("rail", {"position_min_m": -0.01}, "the cart left its limits: -0."),
        ("rail", {"velocity_max_m_s": 0.1}, "a velocity above its limit was sent"),
        ("pressure", {"max_kpa": 2.0}, "a pressure outside its limits was sent"),
    ],
)
def test_values_beyond_a_stricter_limit_are_reported(swing, device, limit, says):
    limits = Limits.model_validate({device: limit})
    (problem,) = exceeded(swing, limits)
    assert problem.startswith(says)
