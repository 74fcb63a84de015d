"""Excitations stay within their limits, play to their end through the daemon, and leave the cart near the middle."""

import math

import numpy as np
import pytest

from softarm.daemon.control.records import Mode
from softarm.daemon.runtime.offline import Lockstep
from softarm.policies.base import PolicyError
from softarm.policies.excite import LEAD_IN_S, Excite
from softarm.schemas.config import Config
from softarm.schemas.excitation import EXCITATIONS
from softarm.schemas.goals import Goal
from softarm.schemas.robot import CART_VELOCITY_MAX_M_S, PRESSURE_MAX_KPA, PRESSURE_MIN_KPA


@pytest.mark.parametrize("name", EXCITATIONS)
def test_an_excitation_stays_within_its_limits_and_ends_at_rest(name):
    plan = EXCITATIONS[name]
    t = np.arange(0, plan.duration_s, 4e-3)
    velocity, pressure = np.array([plan.at(float(x)) for x in t]).T
    assert PRESSURE_MIN_KPA <= pressure.min() <= pressure.max() <= PRESSURE_MAX_KPA
    assert np.abs(velocity).max() <= CART_VELOCITY_MAX_M_S
    assert np.abs(np.cumsum(velocity) * 4e-3).max() <= 0.20
    assert plan.at(plan.duration_s + 0.1) == (0.0, 0.0)
    assert plan.moves_rail == (np.abs(velocity).max() > 0)
    assert max(np.ptp(pressure), 20 * np.ptp(velocity)) > 5  # it does excite


@pytest.mark.parametrize("name", ["both", "free-decay"])
def test_an_excitation_plays_to_its_end_in_the_control_loop(name):
    lockstep = Lockstep(Config(), Excite(name))
    lockstep.arm()
    outputs = lockstep.tick(lockstep.request("goal", Goal("run")))
    farthest, clamps, ticks = 0.0, set(), 1
    while outputs.goal.state == "running":
        outputs = lockstep.tick()
        ticks += 1
        farthest = max(farthest, abs(outputs.rail_position_m))
        clamps |= set(outputs.clamps)
    assert (outputs.goal.state, outputs.mode) == ("reached", Mode.ARMED)
    assert ticks == pytest.approx((LEAD_IN_S + EXCITATIONS[name].duration_s) * 30, abs=2)
    assert farthest < 0.24
    assert not clamps & {"rail_position_max", "rail_position_min", "non_finite"}
    # Once it has ended the arm holds: the policy is not asked any more.
    assert lockstep.tick().action is None


def test_the_lead_in_brings_the_cart_to_the_middle():
    lockstep = Lockstep(Config(), Excite("rail-chirp"))
    lockstep.arm()
    lockstep.place(0.2)
    outputs = lockstep.tick(lockstep.request("goal", Goal("run")))
    for _ in range(math.floor(LEAD_IN_S * 30) - 1):
        outputs = lockstep.tick()
    assert abs(outputs.rail_position_m) < 0.01


def test_an_unknown_excitation_is_refused_with_the_list():
    with pytest.raises(PolicyError, match=r"no excitation 'rail-chrip'; did you mean rail-chirp\? \(there are: seed"):
        Excite("rail-chrip")


def test_a_reset_restarts_the_excitation():
    policy = Excite("seed")
    observation, goal = np.zeros(8, np.float32), np.full(2, np.nan, np.float32)
    first = [policy.step(observation, goal).tolist() for _ in range(300)]
    policy.reset()
    assert [policy.step(observation, goal).tolist() for _ in range(300)] == first
    assert max(pressure for _, pressure in first) > 10
