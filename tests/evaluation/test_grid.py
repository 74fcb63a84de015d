"""Flights of a policy to a grid of targets, their shares, and the faults of the robot."""

from softarm.evaluation.robots import with_faults
from softarm.evaluation.runner import fly_grid
from softarm.policies.base import MODELS
from softarm.reality.parameters import RobotParameters
from softarm.schemas.config import Config, Limits, RailLimits
from softarm.schemas.flights import TEST_TARGETS
from softarm.schemas.model import Model

REACH = MODELS / "reach.onnx"
EASY, NEVER = TEST_TARGETS[4], TEST_TARGETS[-1]  # (-0.20, 0.55), and (0, 0.80), which no command reaches


def test_flights_do_not_depend_on_earlier_ones():
    assert fly_grid(REACH, Model(), (EASY, NEVER)).tolist() == [[True] * 3, [False] * 3]
    assert fly_grid(REACH, Model(), (NEVER, EASY)).tolist() == [[False] * 3, [True] * 3]
    assert not fly_grid("hold", Model(), (EASY,)).any()


def test_flights_use_the_given_configuration():
    held = Config(limits=Limits(rail=RailLimits(velocity_max_m_s=0.02)))
    assert fly_grid(REACH, Model(), (EASY,), held).sum() < 3  # a cart that hardly moves leaves most of it to the muscle


def test_faults_are_set_one_by_one():
    robot = with_faults(RobotParameters(), ["regulator.dead_time_s=0.06", "mocap.loose_link=2"])
    assert robot.regulator.dead_time_s == 0.06
    assert robot.mocap.loose_link == 2
    assert robot.rail == RobotParameters().rail
