"""The next experiment: the excitation that is proposed really separates what it says it separates."""

import re

import numpy as np
import pytest

from softarm.diagnosis.robot.experiments import CHANNELS, NOTHING, repeated, splitting
from softarm.schemas.excitation import EXCITATIONS
from softarm.schemas.model import Model
from softarm.simulator.simulator import Simulator

LAG = {"rail.lag.time": 0.06}
LIMIT = {"rail.acceleration_limit.acceleration": 3.0}


@pytest.fixture(scope="module")
def proposal():
    return splitting(Model(), {"rail.lag": LAG, "rail.acceleration_limit": LIMIT})


def _flown(excitation, point):
    """The channels that the proposal speaks of, flown at another rate than its own, [T, channels]."""
    robot = Simulator(Model(), 1, 600.0, overrides=point)
    plan, seen = EXCITATIONS[excitation], []
    for tick in range(round(plan.duration_s * 30)):
        seen.append((robot.pressure_reading_kpa[0], robot.cart_velocity_m_s[0], *robot.tip_m()[0]))
        robot.step(*plan.at(tick / 30), 1 / 30)
    return np.array(seen, dtype=float)


def _apart(excitation):
    """RMS difference in units of what counts as one, of the channel that differs most."""
    floors = np.array([floor for _, floor in CHANNELS.values()])
    difference = (_flown(excitation, LAG) - _flown(excitation, LIMIT)) / floors
    return float(np.sqrt((difference**2).mean(axis=0)).max())


def test_the_separation_is_real(proposal):
    assert proposal is not None
    assert set(proposal.separates) == {"rail.lag", "rail.acceleration_limit"}
    assert EXCITATIONS[proposal.excitation].moves_rail
    assert _apart(proposal.excitation) > NOTHING


def test_what_is_expected_is_what_one_sees(proposal):
    """The number told for each explanation, read again off an own flight at the time told."""
    baseline = _flown(proposal.excitation, {})
    told = {}
    for name, point in (("rail.lag", LAG), ("rail.acceleration_limit", LIMIT)):
        text = proposal.expect[name]
        channel = next(c for c in CHANNELS if text.startswith(c))
        number, at_s = float(re.search(r"([+-][\d.e-]+)", text)[1]), float(re.search(r"at ([\d.]+) s", text)[1])
        difference = (_flown(proposal.excitation, point) - baseline)[:, list(CHANNELS).index(channel)]
        near = difference[max(0, round(at_s * 30) - 2) : round(at_s * 30) + 3]  # the time is told to a tenth
        assert np.abs(near - number).min() < 0.1 * abs(number) + 0.2 * CHANNELS[channel][1]
        told[name] = number
    assert told["rail.lag"] != told["rail.acceleration_limit"]


def test_what_no_excitation_separates_is_not_worth_a_flight():
    assert splitting(Model(), {"rail.lag": LAG, "the same": dict(LAG)}) is None
    assert splitting(Model(), {"rail.lag": LAG}) is None


def test_what_nobody_knows_is_flown_again():
    assert repeated("rail-chirp").excitation == "rail-chirp"
    assert repeated("a rope and a dog").excitation in EXCITATIONS
    assert set(repeated("both").expect) == set(repeated("both").separates)
