"""Comparison of a run's readings and commands with its limits."""

import pytest

from softarm.daemon.control.records import EStop, Inputs, Mode, Outputs
from softarm.daemon.logbook.logs import exceeded
from softarm.schemas.config import Limits
from softarm.schemas.messages import Command, RailReading


def tick(cart_m: float, *sent: float) -> tuple[Inputs, Outputs]:
    """Return a tick by the cart's position (m), and the sent velocity (m/s) and pressure (kPa)."""
    rail = RailReading(0, cart_m, 0.0, True)
    return Inputs(0, rail=rail), Outputs(0, 1, 0, 0, 0, Mode.ARMED, EStop.CLEAR, Command(True, *sent))


RUN = [tick(-0.05, 0.4, 1.0), tick(0.1, -0.5, 5.0)]


@pytest.mark.parametrize(
    ("limits", "problems"),
    [
        ({}, []),
        ({"rail": {"position_min_m": -0.01}}, ["the cart left its limits: -0.050 to 0.100 m"]),
        ({"rail": {"velocity_max_m_s": 0.45}}, ["a velocity above its limit was sent"]),
        ({"pressure": {"max_kpa": 4.0}}, ["a pressure outside its limits was sent"]),
    ],
)
def test_values_beyond_a_limit_are_reported(limits, problems):
    assert exceeded(RUN, Limits.model_validate(limits)) == problems
    assert exceeded([(Inputs(0), outputs) for _, outputs in RUN], Limits()) == []
