"""Playback of an excitation, live or in lockstep."""

from unittest.mock import AsyncMock

import pytest

from softarm.daemon.logbook import logs
from softarm.daemon.play import play
from softarm.daemon.runtime.devices import simulated_devices
from softarm.schemas import excitation
from softarm.schemas.config import Config

pytestmark = pytest.mark.usefixtures("ordinary_scheduling")


@pytest.fixture
def config(tmp_path, monkeypatch) -> Config:
    """Return a configuration with an excitation of half a second after a lead-in of half a second."""
    short = excitation.Excitation("short", "half a bend", (excitation.Ramp(0.5, 0.0, 8.0),))
    monkeypatch.setitem(excitation.EXCITATIONS, "short", short)
    monkeypatch.setattr("softarm.policies.excite.LEAD_IN_S", 0.5)
    return Config.model_validate({"recorder": {"directory": str(tmp_path)}, "api": {"port": 0}})


@pytest.mark.realtime
def test_live_playback_arms_and_plays(config):
    status, path = play(config, "short", simulated_devices(), lambda time_s: None)
    assert status.state == "reached"
    log = logs.read(path)
    assert log.finished
    assert max(outputs.sent.pressure_kpa for _, outputs in log.ticks()) > 0.0


@pytest.mark.realtime
def test_a_robot_that_cannot_be_armed_is_left_safe(config, monkeypatch):
    monkeypatch.setattr("softarm.daemon.play._ARMING_S", 0.5)
    devices, stop = simulated_devices(), AsyncMock()
    monkeypatch.setattr(devices.mocap, "read", lambda now_ns: ())
    monkeypatch.setattr(devices.mocap, "stop", stop)
    with pytest.raises(RuntimeError, match=r"did not arm within .* s: .*motion capture"):
        play(config, "short", devices, lambda time_s: None)
    assert stop.await_count == 1
