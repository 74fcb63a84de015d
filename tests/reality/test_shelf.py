"""The shelf of the independent robot: solid boards at the simulator's places."""

import numpy as np
import pytest

from softarm.reality.parameters import Arm, RobotParameters
from softarm.reality.plant import RADIUS_M
from softarm.reality.robot import Robot
from softarm.simulator.simulator import Simulator

PERIOD_S = 1 / 30
EDGE_M, BOARD_M = -0.25, 0.55


def swing(shelf_m, air=0.0, steps=30):
    """Tips of the independent robot and of ours, both [steps, 2], swung towards a shelf."""
    robot = Robot(RobotParameters(arm=Arm(air_kg_m3=air)), cart_position_m=0.1, shelf_m=shelf_m)
    simulator = Simulator(None, 1, 1200.0)
    simulator.reset(cart_position_m=0.1)
    if shelf_m:
        simulator.place_shelf(*shelf_m)
    tips = []
    for k in range(steps):
        velocity, pressure = -0.8 if k < 12 else 0.8 if k < 24 else -0.3, 20.0 if k > 8 else 0.0
        robot.command(k * PERIOD_S, velocity, pressure)
        robot.advance((k + 1) * PERIOD_S)
        simulator.step(velocity, pressure)
        tips.append((robot.truth.link_ends_m[-1], simulator.tip_m()[0]))
    return np.array(tips).transpose(1, 0, 2)


@pytest.fixture(scope="module")
def free():
    return swing(None)[0]


@pytest.fixture(scope="module")
def stopped():
    return swing((EDGE_M, BOARD_M))


def test_a_shelf_out_of_reach_changes_nothing(free):
    assert np.array_equal(swing((-5.0, BOARD_M))[0], free)
    air = [swing(shelf, air=8.0, steps=10)[0] for shelf in (None, (-5.0, BOARD_M))]
    assert np.array_equal(*air)


def test_the_arm_does_not_pass_the_boards_edge(free, stopped):
    assert free[:, 0].min() < EDGE_M - 0.15
    assert stopped[0][:, 0].min() > EDGE_M - RADIUS_M / 2


def test_a_shelf_holds_the_arm_as_in_the_simulator(stopped):
    theirs, ours = stopped
    assert np.linalg.norm(theirs - ours, axis=1).max() < 0.05
