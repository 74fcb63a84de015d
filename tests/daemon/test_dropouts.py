"""Simulated flights with dropouts of motion capture."""

import math

import pytest

from softarm.daemon.runtime.offline import Lockstep
from softarm.drivers.bodies.in_process import InProcessMocap
from softarm.policies import registry
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal

TICK_NS = 33_333_333


class Eyes(InProcessMocap):
    """Motion capture at 120 Hz that can be switched off."""

    shut = False

    def read(self, now_ns):
        since_ns = self._robot.now_ns
        frames = [
            f for part in (1, 2, 3, 4) for f in super(Eyes, self).read(since_ns + part * (now_ns - since_ns) // 4)
        ]
        return () if self.shut else tuple(frames)


@pytest.fixture
def swinging():
    daemon = Lockstep(Config(), registry.load("reach"))
    daemon.robot.mocap = eyes = Eyes(daemon.robot)
    daemon.arm()
    daemon.tick(daemon.request("goal", Goal("reach", -0.4, 0.8)))
    for _ in range(12):
        daemon.tick()
    return daemon, eyes


def test_a_simulated_swing_is_known_to_two_centimetres_after_a_dropout_of_150_ms(swinging):
    daemon, eyes = swinging
    eyes.shut = True
    moved_m = 0.0
    at_m = daemon.robot.body.truth.tip_m
    for _ in range(4):
        daemon.tick()
        values, (y_m, z_m) = daemon.outputs.observed.values, daemon.robot.body.truth.tip_m
        assert math.hypot(values.tip_y_m - y_m, values.tip_z_m - z_m) < 0.02
        assert values.cart_position_m == pytest.approx(daemon.robot.body.truth.cart_position_m, abs=0.002)
        assert values.cart_velocity_m_s == pytest.approx(daemon.robot.body.truth.cart_velocity_m_s, abs=0.15)
        moved_m = max(moved_m, math.hypot(y_m - at_m[0], z_m - at_m[1]))
    assert moved_m > 0.15  # what holding on to the last frame would be off
    assert daemon.outputs.observed.bridged_ns == pytest.approx(4 * TICK_NS, abs=10)


def test_a_target_that_only_the_estimate_reaches_is_not_reached(swinging):
    daemon, eyes = swinging
    y_m, z_m = daemon.robot.body.truth.tip_m
    eyes.shut = True
    daemon.tick()
    values = daemon.outputs.observed.values
    ahead = Goal("reach", 2 * values.tip_y_m - y_m, 2 * values.tip_z_m - z_m)  # where the tip goes
    daemon.tick(daemon.request("goal", ahead))
    values = daemon.outputs.observed.values
    assert math.hypot(values.tip_y_m - ahead.y_m, values.tip_z_m - ahead.z_m) < 0.04
    daemon.tick()
    assert daemon.outputs.goal.state == "running"
