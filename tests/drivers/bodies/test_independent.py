"""The independent robot in this process: the daemon cannot tell it from the simulated one, but by how it flies."""

import pytest

from softarm.daemon.shell.offline import Lockstep
from softarm.drivers.bodies.independent import IndependentRobot
from softarm.policies import registry
from softarm.policies.hold import Hold
from softarm.reality.parameters import Parameters, Rail
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal


def test_it_hangs_where_it_was_made_until_it_is_told_to_move_and_stops_when_it_is_not_enabled():
    robot = IndependentRobot(cart_position_m=0.1)
    (*_, frame) = robot.mocap.read(200_000_000)
    assert frame.bodies[0].y_m == pytest.approx(0.1, abs=0.002)
    assert robot.rail.read().position_m == pytest.approx(0.1, abs=0.002)
    assert not robot.rail.read().enabled
    assert not robot.regulator.read().armed

    robot.rail.write(True, 0.3)
    robot.regulator.write(True, 10.0)
    robot.mocap.read(700_000_000)
    assert robot.cart_position_m > 0.15
    assert robot.rail.read().enabled
    assert robot.regulator.read().armed
    assert robot.regulator.read().pressure_kpa > 5.0

    robot.rail.write(False, 0.3)
    robot.regulator.write(False, 10.0)
    robot.mocap.read(1_700_000_000)
    held = robot.cart_position_m
    robot.mocap.read(2_200_000_000)
    assert robot.cart_position_m == pytest.approx(held, abs=0.01)
    assert robot.regulator.read().pressure_kpa < 1.0


def test_the_daemons_own_tick_flies_it_and_a_change_of_the_robot_is_felt():
    def closest_m(parameters):
        daemon = Lockstep(Config(), registry.load("reach"), robot=IndependentRobot(parameters, cart_position_m=0.1))
        daemon.arm()
        flight = daemon.pursue(Goal("reach", -0.2, 0.6))
        assert flight.max_cart_m >= 0.1
        return flight.status.closest_m, flight.reached

    nominal, late = closest_m(None), closest_m(Parameters(rail=Rail(delay_s=0.05)))
    assert nominal[1]
    assert nominal[0] != late[0]


def test_it_cannot_be_put_anywhere():
    daemon = Lockstep(Config(), Hold(), robot=IndependentRobot())
    with pytest.raises(TypeError, match="IndependentRobot cannot be put anywhere"):
        daemon.fly(Goal("reach", -0.2, 0.6), 0.1)


def test_ticks_are_a_thirtieth_of_a_second_however_many_there_were():
    daemon = Lockstep(Config(), Hold(), robot=IndependentRobot())
    for _ in range(90):
        daemon.tick()
    assert daemon.robot.now_ns == 3_000_000_000
