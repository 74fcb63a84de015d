"""Devices of a robot simulated in the daemon's process."""

import time

import pytest

from softarm.daemon.runtime.devices import simulated_devices


@pytest.mark.parametrize(("hold_s", "is_moving"), [(60.0, True), (0.01, False)])
def test_a_set_point_of_the_simulated_rail_expires_as_configured(hold_s, is_moving):
    devices = simulated_devices(hold_s=hold_s)
    devices.rail.write(True, 0.3)
    devices.mocap.read(time.monotonic_ns() + 500_000_000)
    assert (abs(devices.rail.read().velocity_m_s) > 0.1) == is_moving
