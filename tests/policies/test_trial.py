"""Trial of a policy in a separate process, which may crash or hang."""

import json
import os
import subprocess
import sys
import threading

import pytest

from softarm.policies import trial
from softarm.policies.base import PolicyError, PolicySpec
from softarm.policies.trial import try_out
from softarm.schemas.config import Policy as Configured
from tests.daemon.rig import Steady
from tests.processes import gone, until

pytestmark = pytest.mark.timeout(120)

PLUGIN = """
import os, pathlib, signal, sys, time
import numpy as np
from softarm.policies.base import PolicySpec

assert os.sched_getscheduler(0) == os.SCHED_OTHER

class Plugged:
    spec = PolicySpec("plugged", "does as its option says")

    def __init__(self, does="well"):
        self.does = does
        print("I am loaded")
        if does == "wedges":
            pathlib.Path(__file__).with_name("wedged").write_text(str(os.getpid()))
            while True:
                pass

    def reset(self):
        pass

    def step(self, observation, goal):
        if self.does == "crashes":
            os.kill(os.getpid(), signal.SIGSEGV)
        if self.does == "leaves":
            os._exit(3)
        if self.does == "hoards":
            np.ones(40 * 1024**3, dtype=np.uint8)
        return np.zeros(2, dtype=np.float32)
"""

DAEMON = """
import json, sys
from softarm.policies.trial import try_out
from softarm.schemas.config import Policy
try_out("mine", {name: Policy.model_validate(one) for name, one in json.loads(sys.argv[1]).items()}, 600)
"""


@pytest.fixture
def plugged(install, tmp_path, monkeypatch):
    """Configure a policy of an installed plug-in by its behaviour: well, wedges, crashes, ..."""
    install("other_arm", PLUGIN, plugged="Plugged")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    return lambda does: {"mine": Configured(plugin="plugged", options={"does": does})}


def test_a_trial_does_not_inherit_the_daemons_priority(plugged):
    thread = threading.get_native_id()
    try:
        os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(1))
    except PermissionError:
        pytest.skip("this machine grants no real-time priority")
    try:
        try_out("mine", plugged("well"), 60)
    finally:
        os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))


@pytest.mark.parametrize(
    ("does", "sentence"),
    [
        ("leaves", "policy 'mine': its process ended with exit code 3"),
        ("hoards", r"policy 'mine': step raised .*MemoryError: Unable to allocate"),
    ],
)
def test_a_failed_trial_is_reported(plugged, does, sentence):
    with pytest.raises(PolicyError, match=sentence):
        try_out("mine", plugged(does), 60)


@pytest.mark.parametrize(("wants_tracking", "values"), [(False, 8), (True, 10)])
def test_a_trial_gives_the_observation_of_a_flight(wants_tracking, values):
    policy = trial.ready(Steady(spec=PolicySpec("mine", "for tests", wants_tracking=wants_tracking)))
    assert [observation.shape for observation, _ in policy.seen] == [(values,)] * 2
    assert policy.resets == 2


@pytest.mark.parametrize(
    ("action", "sentence"),
    [
        ([0.0, 0.0], "list instead of a numpy array"),
        ((0.0, 0.0, 0.0), r"an array of shape \[3\] instead of \[2\]"),
        ((float("nan"), 0.0), r"\[nan, 0.0\], which is not finite"),
    ],
)
def test_a_policy_with_a_wrong_action_is_refused(action, sentence):
    with pytest.raises(PolicyError, match=f"'mine': step returned {sentence}; it must .*; repair it"):
        trial.ready(Steady(action, PolicySpec("mine", "for tests")))


@pytest.mark.slow
def test_a_trial_that_never_ends_is_killed(plugged):
    with pytest.raises(PolicyError, match="no first step within 1 s"):
        try_out("mine", plugged("wedges"), 1)


@pytest.mark.slow
def test_a_trial_ends_with_its_daemon(plugged, tmp_path):
    policies = {name: one.model_dump() for name, one in plugged("wedges").items()}
    mark = tmp_path / "wedged"
    with subprocess.Popen([sys.executable, "-c", DAEMON, json.dumps(policies)]) as daemon:
        until(lambda: mark.exists() and mark.read_text(), "the trial")
        daemon.kill()
    until(lambda: gone(int(mark.read_text())), "the end of the trial")


def test_a_policy_is_loaded_only_after_its_trial(plugged):
    """A good one passes, whatever it prints."""
    assert trial.load("mine", plugged("well"), 60).spec.name == "mine"
    with pytest.raises(PolicyError, match="policy 'mine': its process ended by SIGSEGV during its trial"):
        trial.load("mine", plugged("crashes"), 60)
