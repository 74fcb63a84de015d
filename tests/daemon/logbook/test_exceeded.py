"""A run is measured against its limits by what was read and sent."""

import pytest

from softarm.daemon.control.records import Inputs, Outputs
from softarm.daemon.logbook.exceeded import exceeded
from softarm.daemon.shell.offline import Lockstep
from softarm.policies import registry
from softarm.schemas.config import Config, Limits
from softarm.schemas.goals import Goal


class Kept:
    """A recorder that keeps its ticks."""

    def __init__(self) -> None:
        self.ticks: list[tuple[Inputs, Outputs]] = []

    def tick(self, inputs: Inputs, outputs: Outputs, _timing: object) -> None:
        self.ticks.append((inputs, outputs))


@pytest.fixture(scope="module")
def swing() -> list[tuple[Inputs, Outputs]]:
    kept = Kept()
    Lockstep(Config(), registry.load("reach"), recorder=kept).fly(Goal("reach", -0.2, 0.6), 0.0)
    return kept.ticks


def test_a_swing_keeps_to_its_own_limits(swing):
    assert exceeded(swing, Config().limits) == []


@pytest.mark.parametrize(
    ("device", "limit", "says"),
    [
        ("rail", {"position_min_m": -0.01}, "the cart left its limits: -0."),
        ("rail", {"velocity_max_m_s": 0.1}, "a velocity above its limit was sent"),
        ("pressure", {"max_kpa": 2.0}, "a pressure outside its limits was sent"),
    ],
)
def test_what_a_narrower_limit_would_not_have_allowed_is_told(swing, device, limit, says):
    limits = Limits.model_validate({device: limit})
    (problem,) = exceeded(swing, limits)
    assert problem.startswith(says)
