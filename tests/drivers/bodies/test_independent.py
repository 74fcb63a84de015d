"""Body of the independent robot: the same interface as the simulated one."""

import numpy as np
import pytest

from softarm.daemon.runtime.offline import Lockstep
from softarm.drivers.bodies.base import PlacementError
from softarm.drivers.bodies.independent import IndependentBody
from softarm.policies import registry
from softarm.policies.hold import Hold
from softarm.reality.parameters import Mocap, PressureSensor, Rail, RobotParameters
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal
from softarm.schemas.messages import BODY_NAMES

FRAME_NS = 8_333_334


def test_the_daemons_tick_flies_it_and_a_change_of_the_robot_matters():
    def closest_m(parameters):
        daemon = Lockstep(Config(), registry.load("reach"), body=IndependentBody(parameters, cart_position_m=0.1))
        daemon.arm()
        flight = daemon.pursue(Goal("reach", -0.2, 0.6))
        assert flight.max_cart_m >= 0.1
        return flight.status.closest_m, flight.reached

    nominal, late = closest_m(None), closest_m(RobotParameters(rail=Rail(delay_s=0.05)))
    assert nominal[1]
    assert nominal[0] != late[0]


def test_placing_it_is_refused():
    daemon = Lockstep(Config(), Hold(), body=IndependentBody())
    with pytest.raises(PlacementError, match="cannot be placed: create it at its starting position"):
        daemon.fly(Goal("reach", -0.2, 0.6), 0.1)


def test_it_moves_as_commanded_and_returns_its_sensors_readings():
    parameters = RobotParameters(
        mocap=Mocap(transport_s=0.02, noise_m=0.0),
        pressure_sensor=PressureSensor(bias_kpa=1.0, noise_kpa=0.0),
    )
    body = IndependentBody(parameters, cart_position_m=0.1)
    assert body.encoder().position_m == pytest.approx(0.1, abs=0.002)
    seen = []
    for _ in range(60):
        body.step(-0.3, 15.0, FRAME_NS)
        seen.append(body.frames())
    assert seen[5][0].bodies[0].y_m == pytest.approx(0.1, abs=0.002)
    assert body.truth.cart_position_m < 0.05
    assert body.gauge().pressure_kpa == pytest.approx(body.truth.pressure_kpa + 1.0, abs=0.01)
    assert body.gauge() is body.gauge()
    assert body.encoder().position_m == pytest.approx(body.truth.cart_position_m, abs=0.005)
    assert body.encoder().velocity_m_s == pytest.approx(-0.3, abs=0.1)
    assert seen[0] == ()
    (newest,) = seen[-1]
    assert body.now_ns - newest.t_capture_ns == pytest.approx(20e6, abs=10e6)
    assert newest.t_receive_ns - newest.t_capture_ns == 20_000_000
    assert len(newest.bodies) == len(BODY_NAMES)
    assert np.hypot(*np.subtract(newest.bodies[-1][:2], body.truth.tip_m)) < 0.03
