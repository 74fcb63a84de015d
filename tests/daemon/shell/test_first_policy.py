"""The daemon's first policy is a guest like those that come later: it may crash or wedge, and costs the start alone."""

import os
import signal
import subprocess
import sys
import threading
import time

import pytest
import yaml

from softarm.daemon.shell.first_policy import first_policy
from softarm.policies.base import PolicyError
from softarm.schemas.config import Config

pytestmark = pytest.mark.timeout(120)

PLUGIN = """
import os, pathlib, signal
from softarm.policies.base import PolicySpec

class Guest:
    spec = PolicySpec("guest", "does as its option says")

    def __init__(self, does, mark="/dev/null"):
        pathlib.Path(mark).write_text("loading")
        if does == "crashes":
            os.kill(os.getpid(), signal.SIGSEGV)
        while does == "wedges":
            pass
"""


@pytest.fixture
def guest(tmp_path, monkeypatch):
    """guest(does): a configuration that begins with a policy of an installed plugin."""
    (tmp_path / "guest_arm.py").write_text(PLUGIN)
    info = tmp_path / "guest_arm-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: guest-arm\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[softarm.policies]\nguest = guest_arm:Guest\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)

    def made(does: str) -> dict:
        options = {"does": does, "mark": str(tmp_path / "mark")}
        return {"control": {"policy": "mine"}, "policies": {"mine": {"plugin": "guest", "options": options}}}

    return made


def until(condition):
    deadline = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_a_good_one_is_loaded_and_has_done_its_first_step():
    policy = first_policy(Config(control={"policy": "hold"}), threading.Event())
    assert policy.spec.name == "hold"


@pytest.mark.slow
@pytest.mark.parametrize(("does", "sentence"), [("crashes", "its process ended by SIGSEGV"), ("wedges", "within 3 s")])
def test_what_goes_wrong_is_told_in_time(guest, does, sentence):
    with pytest.raises(PolicyError, match=sentence):
        first_policy(Config(**guest(does)), threading.Event(), loading_s=60 if does == "crashes" else 3)


@pytest.mark.slow
def test_the_end_of_the_service_does_not_wait_for_it(guest, tmp_path):
    over = threading.Event()
    threading.Thread(target=lambda: (until((tmp_path / "mark").exists), over.set())).start()
    assert first_policy(Config(**guest("wedges")), over, loading_s=20) is None
    assert over.is_set()


@pytest.mark.slow
def test_a_service_whose_first_policy_wedges_ends_when_it_is_told(guest, tmp_path):
    settings = guest("wedges") | {"recorder": {"directory": str(tmp_path)}, "api": {"port": 0}}
    (tmp_path / "arm.yaml").write_text(yaml.safe_dump(settings))
    command = [sys.executable, "-m", "softarm.cli.main", "run", "--config", str(tmp_path / "arm.yaml")]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE) as process:
        try:
            until((tmp_path / "mark").exists)
            process.send_signal(signal.SIGTERM)
            assert process.wait(5) == 0
        finally:
            process.kill()
