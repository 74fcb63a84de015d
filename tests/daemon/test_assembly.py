"""Loading of the first policy, which may hang."""

import os
import signal
import threading

import pytest
import yaml

from softarm.daemon.assembly import wait_for
from tests.processes import running, until

pytestmark = pytest.mark.timeout(120)

PLUGIN = """
import pathlib
from softarm.policies.base import PolicySpec

class Plugin:
    spec = PolicySpec("plugin", "hangs while it loads")

    def __init__(self, mark):
        pathlib.Path(mark).write_text("loading")
        while True:
            pass
"""


@pytest.mark.slow
def test_a_service_whose_first_policy_hangs_ends_on_request(install, tmp_path, monkeypatch):
    install("plugin_arm", PLUGIN, plugin="Plugin")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    settings = {
        "control": {"policy": "mine"},
        "policies": {"mine": {"plugin": "plugin", "options": {"mark": str(tmp_path / "mark")}}},
        "recorder": {"directory": str(tmp_path)},
        "api": {"port": 0},
    }
    (tmp_path / "arm.yaml").write_text(yaml.safe_dump(settings))
    with running("run", "--config", tmp_path / "arm.yaml") as process:
        until((tmp_path / "mark").exists)
        process.send_signal(signal.SIGTERM)
        assert process.wait(5) == 0


# A wait that a signal does not end would block the signal of an ordinary time limit too.
@pytest.mark.timeout(120, method="thread")
def test_a_signal_at_any_instant_ends_the_wait():
    """The signal comes just before, while and after the main thread begins to wait."""
    before = signal.getsignal(signal.SIGALRM)
    try:
        for turn in range(1000):
            stop = threading.Event()
            signal.signal(signal.SIGALRM, lambda *_, stop=stop: stop.set())
            signal.setitimer(signal.ITIMER_REAL, 1e-5 + turn % 50 * 1e-6)
            wait_for(stop, 1e-4)
            assert stop.is_set()
    finally:
        signal.signal(signal.SIGALRM, before)
