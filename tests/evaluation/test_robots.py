"""Faults of the independent robot."""

from softarm.evaluation.robots import with_faults
from softarm.reality.parameters import RobotParameters


def test_faults_are_set_one_by_one():
    robot = with_faults(RobotParameters(), ["regulator.dead_time_s=0.06", "mocap.loose_link=2"])
    assert robot.regulator.dead_time_s == 0.06
    assert robot.mocap.loose_link == 2
    assert robot.rail == RobotParameters().rail
