"""Measured limits cover the simulated robot and hold against an attack."""

import numpy as np
import pytest

from softarm.daemon.limits.findings import EXCITATION, findings
from softarm.policies.excite import Excite
from validation.limits import Attack, Robot, fly

pytestmark = pytest.mark.slow


def test_a_late_and_weak_rail_with_a_payload_is_measured_patched_and_held():
    robot = Robot("simulator", ramp_m_s2=3.0, latency_s=0.06, payload_kg=0.05, age_s=0.03)
    careful = robot.config(latency_s=0.15, braking_m_s2=0.75, surge_m_s2=6.0)
    played = fly(robot, careful, Excite(EXCITATION), 33.0, None)
    found = findings([played.motion], robot.config(latency_s=0.005))
    patched = found.patched.limits.rail
    assert 0.085 <= patched.latency_s <= 0.115  # the reading's hidden age is latency to the filter
    assert patched.braking_m_s2 < 3.0 < patched.surge_m_s2
    accelerations = np.diff(played.motion.velocity_m_s) / np.diff(played.motion.t_s)
    assert np.mean(np.abs(accelerations) > patched.surge_m_s2) < 0.01
    attacked = fly(robot, found.patched, Attack(2), 6.0, None)
    assert attacked.farthest_m < 0.255
    assert attacked.stops == 0
