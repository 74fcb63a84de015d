"""The two policies that need no training."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softarm.policies.base import PolicyError
from softarm.policies.hold import Hold
from softarm.policies.pid import Pid

metres = st.floats(-2, 2, width=32)
speeds = st.floats(-5, 5, width=32)


def observe(tip_y=0.0, tip_z=0.5225, tip_vy=0.0, tip_vz=0.0):
    return np.array([0.1, 0.2, tip_y, tip_z, tip_vy, tip_vz, 0.3, 4.0], dtype=np.float32)


def goal(y, z):
    return np.array([y, z], dtype=np.float32)


@pytest.mark.parametrize("rest", [0.0, 3.5, -0.7, 20.0])
def test_hold_stands_still_at_its_rest_pressure_without_a_target(rest):
    action = Hold(rest_pressure_kpa=rest).step(observe(tip_vy=3), goal(np.nan, np.nan))
    np.testing.assert_array_equal(action, np.array([0, rest], dtype=np.float32))


@pytest.mark.parametrize("rest", [-0.71, 20.1, float("nan"), float("inf")])
def test_hold_refuses_a_rest_pressure_outside_the_muscles_range(rest):
    with pytest.raises(PolicyError, match=r"rest_pressure_kpa is .*; allowed -0\.7 to 20\.0 kPa"):
        Hold(rest_pressure_kpa=rest)


def test_pid_has_the_papers_gains():
    action = Pid().step(observe(tip_y=0.05, tip_z=0.52), goal(-0.25, 0.56))
    np.testing.assert_allclose(action, [-1.0 * (0.05 + 0.25), -20.0 * (0.52 - 0.56)], rtol=1e-5)


@given(metres, metres, speeds, speeds, metres, metres)
def test_pid_stays_within_the_robots_ranges_and_pushes_towards_the_target(y, z, vy, vz, target_y, target_z):
    velocity, pressure = Pid().step(observe(y, z, vy, vz), goal(target_y, target_z))
    assert -1 <= velocity <= 1
    assert -0.7 - 1e-6 <= pressure <= 20
    assert velocity * (target_y - y) >= 0
    if target_z > z:
        assert pressure >= 0


def test_a_derivative_gain_damps_and_an_integral_gain_adds_up_until_reset():
    damped = Pid(kp_y=0, kp_z=0, kd_y=0.1, kd_z=2.0)
    np.testing.assert_allclose(damped.step(observe(tip_vy=1, tip_vz=-1), goal(0, 0)), [-0.1, 2.0], rtol=1e-6)
    summed = Pid(kp_y=0, kp_z=0, ki_y=0.3, ki_z=3.0)
    pushes = [summed.step(observe(0.1, 0.5), goal(0, 0.6)) for _ in range(30)]
    np.testing.assert_allclose(pushes[-1], [-0.03, 0.3], rtol=1e-4)  # one second of it
    summed.reset()
    np.testing.assert_array_equal(summed.step(observe(0.1, 0.5), goal(0, 0.6)), pushes[0])


def test_an_integral_does_not_wind_up_while_its_action_is_at_a_limit():
    pid = Pid(kp_y=1.0, ki_y=10.0)
    for _ in range(300):
        assert pid.step(observe(tip_y=2.0), goal(0, 0.5225))[0] == -1.0
    assert pid.step(observe(tip_y=-0.1), goal(0, 0.5225))[0] > 0


@pytest.mark.parametrize("gain", [-1.0, float("nan"), float("inf")])
def test_a_negative_gain_is_refused(gain):
    with pytest.raises(PolicyError, match=r"option kd_z is .*; allowed 0 or more"):
        Pid(kd_z=gain)
