"""Many flights in parts, and the robots that they are flown on."""

import numpy as np
import pytest

from softarm.flights.many import fly_all, fly_grid, shares
from softarm.flights.robots import with_faults
from softarm.policies.base import MODELS
from softarm.reality.parameters import RobotParameters
from softarm.schemas.config import Config, Limits, RailLimits
from softarm.schemas.flights import TEST_TARGETS
from softarm.schemas.model import Model

REACH = MODELS / "reach.onnx"
EASY, NEVER = TEST_TARGETS[4], TEST_TARGETS[-1]  # (-0.20, 0.55), and (0, 0.80), which no command reaches


def test_flights_are_the_same_in_parts():
    reached = fly_grid(REACH, Model(), (EASY, NEVER))
    assert reached.tolist() == [[True] * 3, [False] * 3]
    told = []
    flown = fly_all({"old": REACH}, {"nominal": Model()}, (EASY, NEVER), told.append, processes=1)
    assert told == [6]
    assert np.array_equal(flown["old", "nominal"], reached)


def test_they_are_flown_by_the_configuration_that_is_given():
    held = Config(limits=Limits(rail=RailLimits(velocity_max_m_s=0.02)))
    reached = fly_grid(REACH, Model(), (EASY,), held)
    assert reached.sum() < 3  # a cart that hardly moves leaves most of it to the muscle
    flown = fly_all({"old": REACH}, {"nominal": Model()}, (EASY,), processes=1, config=held)
    assert np.array_equal(flown["old", "nominal"], reached)


@pytest.mark.slow
def test_every_policy_flies_on_every_robot_from_any_number_of_processes(monkeypatch):
    monkeypatch.setattr("softarm.flights.many._PART", 1)
    policies = {"file": REACH, "plugin": "hold"}
    robots = {"nominal": Model(), "independent": RobotParameters()}
    flown = fly_all(policies, robots, (EASY, NEVER), processes=2)
    assert {key: reached.shape for key, reached in flown.items()} == {
        (policy, robot): (2, 3) for policy in policies for robot in robots
    }
    assert flown["file", "nominal"].tolist() == [[True] * 3, [False] * 3]
    assert flown["file", "independent"][0].any()
    assert not flown["plugin", "nominal"].any()
    assert not flown["plugin", "independent"].any()


def test_shares_are_by_where_the_targets_lie():
    old, new = np.array([[True, True], [False, False]]), np.array([[False, True], [True, True]])
    assert shares(old, (EASY, NEVER)).in_range == 1.0
    assert shares(new, (EASY, NEVER)).above == 1.0
    assert shares(new, (EASY, NEVER)).all == 0.75


def test_faults_are_set_one_by_one():
    robot = with_faults(RobotParameters(), ["regulator.dead_time_s=0.06", "mocap.loose_link=2"])
    assert robot.regulator.dead_time_s == 0.06
    assert robot.mocap.loose_link == 2
    assert robot.rail == RobotParameters().rail
