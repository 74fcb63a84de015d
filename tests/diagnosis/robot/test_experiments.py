"""The next experiment: the excitation that is proposed really separates what it says it separates, and is a new one."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.robot import experiments
from softarm.diagnosis.robot.candidates import nuisances
from softarm.diagnosis.robot.experiments import LEAST, NOTHING, closest, flights, repeated, splitting
from softarm.diagnosis.robot.trial_grid import on_grid
from softarm.diagnosis.robot.views import FLOOR_M_S, robot_views
from softarm.schemas.excitation import EXCITATIONS
from softarm.schemas.model import Model
from softarm.simulator.simulator import Simulator

LAG = {"rail.lag.time": 0.06}
LIMIT = {"rail.acceleration_limit.acceleration": 3.0}
GAIN, BIAS = {"pressure.gain.offset": 2.8}, {"pressure.sensor_bias.bias": 2.8}
KINDS = ("free-decay", "rail-chirp", "rail-dashes", "both")
RAIL = {"rail.lag": LAG, "rail.acceleration_limit": LIMIT}
PRESSURE = {"pressure.gain": GAIN, "pressure.sensor_bias": BIAS}


@pytest.fixture(scope="module", autouse=True)
def few():
    """Offer four excitations, since each takes its time for every explanation."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(experiments, "EXCITATIONS", {kind: EXCITATIONS[kind] for kind in KINDS})
        yield


@cache
def _flown(point):
    """Return a simulated trial of every kind, from ((path, value), ...)."""
    return {trial.kind: trial for trial in flights(Model(), dict(point))}


def _recorded(kinds, point, without=()):
    """Return the problem of simulated trials of these kinds; without: channels that were not recorded."""
    flown = _flown(tuple(point.items()))
    trials = [
        replace(flown[kind], channels={name: c for name, c in flown[kind].channels.items() if name not in without})
        for kind in kinds
    ]
    return Setup(robot_views(on_grid(trials, Model()), Model()), nuisances(Model()), kinds).plain()


@pytest.fixture(scope="module")
def swinging():
    """Return the problem of a trial that does not move the rail."""
    return _recorded(["free-decay"], {})


@pytest.fixture(scope="module")
def proposal(swinging):
    return splitting(Model(), RAIL, swinging, ["free-decay"])


def _velocity(excitation, point):
    """The cart's velocity at 60 Hz, at another rate than the proposal's own, from a robot that hangs still."""
    robot = Simulator(Model(), 1, 600.0, overrides=point)
    plan, seen = EXCITATIONS[excitation], []
    robot.step(*plan.at(0.0), 20.0)
    for step in range(round(plan.duration_s * 60)):
        seen.append(robot.cart_velocity_m_s[0])
        robot.step(*plan.at(step // 2 / 30), 1 / 60)
    return np.array(seen, dtype=float)


def test_the_separation_is_real_and_the_expected_result_is_the_simulated_one(proposal):
    assert set(proposal.separates) == set(RAIL)
    apart = _velocity(proposal.excitation, LAG) - _velocity(proposal.excitation, LIMIT)
    assert np.sqrt(np.mean(apart**2)) > LEAST * FLOOR_M_S
    baseline, found = _velocity(proposal.excitation, {}), {}
    for name, point in RAIL.items():
        text = proposal.expect[name]
        assert text.startswith("rail, velocity: ")
        number, at_s = float(re.search(r": ([+-][\d.e-]+)", text)[1]), float(re.search(r"at ([\d.]+) s", text)[1])
        change = _velocity(proposal.excitation, point) - baseline
        near = change[max(0, round(at_s * 60) - 4) : round(at_s * 60) + 5]  # the time is rounded to a tenth
        assert np.abs(near - number).min() < 0.1 * abs(number) + 0.2 * FLOOR_M_S
        found[name] = number
    assert abs(found["rail.lag"] - found["rail.acceleration_limit"]) > FLOOR_M_S


def test_a_flight_begins_with_a_robot_that_hangs_still():
    (chirp,) = (t for t in flights(Model(), {"arm.stiffness.scale": -0.3}) if t.kind == "rail-chirp")
    mocap = chirp.channels["mocap"]
    still = mocap.t_s < 0.9  # before the first step
    for part in ("y", "z"):
        assert np.ptp(mocap[f"link5_{part}"][still]) < 1e-4
    assert np.ptp(mocap["link5_y"][~still]) > 0.05
    assert abs(mocap["link5_y"][0]) > 1e-3  # it does not hang straight


def test_an_inseparable_pair_is_reported(swinging):
    same = splitting(Model(), {"rail.lag": LAG, "the same": dict(LAG)}, swinging, ["free-decay"])
    assert same.excitation.startswith(NOTHING)
    assert same.separates == ("rail.lag", "the same")
    assert not same.expect  # there is nothing to play


def test_a_recorded_excitation_is_not_proposed_again(proposal):
    kinds = [proposal.excitation, "free-decay"]
    found = splitting(Model(), RAIL, _recorded(kinds, LAG), kinds)
    assert found.excitation == "rail-dashes" != proposal.excitation


@pytest.mark.prove
def test_a_separation_like_the_recorded_one_is_not_enough(proposal):
    kinds = [proposal.excitation, "rail-dashes"]
    found = splitting(Model(), RAIL, _recorded(kinds, LAG), kinds)
    assert found.excitation.startswith(NOTHING)


@pytest.mark.prove
def test_a_repeat_is_asked_for_where_it_shows_a_stage_that_was_not_recorded():
    """The arm feels a wrong zero of the regulator, never its sensor's bias; no camera was there to see it."""
    kinds = list(KINDS)
    found = splitting(Model(), PRESSURE, _recorded(kinds, GAIN, without=("mocap",)), kinds)
    assert found.excitation in EXCITATIONS
    assert all(text.startswith("arm, link ") for text in found.expect.values())


def test_nuisances_take_their_share():
    problem = _recorded(["both"], {})
    late = {"pressure.dead_time.delay": 0.005}
    assert closest(problem, [{}, late]).max() < 0.1
    assert closest(problem, [{}, {"pressure.dead_time.delay": 0.05}]).max() > 5 * LEAST


def test_an_unknown_effect_is_repeated():
    assert repeated("rail-chirp").excitation == "rail-chirp"
    assert repeated("a rope and a dog").excitation in EXCITATIONS
    assert set(repeated("both").expect) == set(repeated("both").separates)
