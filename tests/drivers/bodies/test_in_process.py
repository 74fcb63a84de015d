"""In-process devices of either body, on the caller's time."""

import pytest

from softarm.drivers.bodies.in_process import InProcessRobot
from softarm.drivers.bodies.independent import IndependentBody
from softarm.drivers.bodies.simulated import SimulatedBody

BOOTED_NS = 123_456_789_012_345
PERIOD_NS = 33_333_333


@pytest.fixture(params=[SimulatedBody, IndependentBody])
def robot(request):
    return InProcessRobot(request.param(), BOOTED_NS)


def test_every_stamp_is_on_the_callers_clock(robot):
    for tick in range(1, 4):
        now_ns = BOOTED_NS + tick * PERIOD_NS
        *_, frame = robot.mocap.read(now_ns)
        for stamp_ns in (frame.t_capture_ns, robot.regulator.read().t_receive_ns, robot.rail.read().t_receive_ns):
            assert now_ns - 10_000_000 < stamp_ns <= now_ns
    assert robot.body.now_ns == 3 * PERIOD_NS


def test_the_robot_moves_under_the_last_commands_and_only_while_enabled(robot):
    def fly(enable):
        robot.regulator.write(enable, 10.0)
        for _ in range(15):
            robot.rail.write(enable, 0.4)
            robot.mocap.read(robot.now_ns + PERIOD_NS)
        return robot.body.truth, robot.rail.read(), robot.regulator.read()

    truth, rail, regulator = fly(True)
    assert truth.cart_velocity_m_s == pytest.approx(0.4, abs=0.1)
    assert truth.pressure_kpa > 7.0
    assert (rail.enabled, regulator.armed, regulator.sequence) == (True, True, 1)
    truth, rail, regulator = fly(False)
    assert truth.cart_velocity_m_s == pytest.approx(0.0, abs=0.1)
    assert truth.pressure_kpa < 3.0
    assert (rail.enabled, regulator.armed, regulator.sequence) == (False, False, 2)


def test_a_set_point_that_is_not_renewed_brakes_the_cart_until_the_next_one(robot):
    for tick in range(1, 16):
        robot.rail.write(True, 0.4)
        robot.mocap.read(BOOTED_NS + tick * PERIOD_NS)
    moved = robot.body.truth.cart_position_m
    robot.mocap.read(robot.now_ns + 30 * PERIOD_NS)
    assert robot.body.truth.cart_velocity_m_s == pytest.approx(0.0, abs=0.1)
    assert robot.body.truth.cart_position_m < moved + 0.4 * (0.045 + 0.034) + 0.4**2 / 6
    robot.rail.write(True, 0.4)
    robot.mocap.read(robot.now_ns + PERIOD_NS)
    robot.rail.write(True, 0.4)
    robot.mocap.read(robot.now_ns + 3 * PERIOD_NS // 2)
    assert robot.body.truth.cart_velocity_m_s > 0.05


def test_skipped_time_moves_nothing(robot):
    robot.rail.write(True, 0.5)
    robot.mocap.read(BOOTED_NS + PERIOD_NS)
    before = robot.body.truth.cart_position_m
    robot.now_ns += 10_000_000_000
    robot.mocap.read(robot.now_ns)
    assert robot.body.truth.cart_position_m == before
    assert robot.body.now_ns == PERIOD_NS


def test_a_reading_is_the_same_object_until_the_sensor_has_a_new_one():
    robot = InProcessRobot(IndependentBody())
    robot.mocap.read(PERIOD_NS)
    assert robot.rail.read() is robot.rail.read()
    assert robot.regulator.read() is robot.regulator.read()
    first = robot.rail.read()
    robot.mocap.read(2 * PERIOD_NS)
    assert robot.rail.read().t_receive_ns > first.t_receive_ns
