"""An excitation as a job: its requests to the control loop, and the policy that it leaves behind."""

import math
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from softarm.daemon.runtime import excitation
from softarm.daemon.runtime.excitation import Excitation
from softarm.daemon.runtime.jobs import JobError
from softarm.policies.onnx_policy import OnnxPolicy
from softarm.policies.runner import InlineRunner, ThreadRunner
from softarm.schemas.config import Config


@pytest.fixture(autouse=True)
def _short(monkeypatch):
    monkeypatch.setattr(excitation, "_AFTER_S", 0.0)


def network(name):
    policy = OnnxPolicy(name)
    policy.step_s = 1e-4
    return policy


def prepared(loop):
    """Return an excitation on a control loop that accepts every policy and ends every goal at once."""

    def snapshot():
        used = [post.request.policy for post in loop.taken if post.request.kind == "policy"]
        return replace(loop.outputs, policy=used[-1] if used else "reach")

    recorder = SimpleNamespace(path=Path("0.mcap"), begun_ns=time.monotonic_ns(), problem=None)
    recorder.split = lambda: setattr(recorder, "path", Path("1.mcap"))
    return Excitation("seed", loop.inbox, snapshot, recorder, network, Config(), "test")


def ignored(text, share):
    pass


def test_the_earlier_network_runs_on_the_loops_thread_again(loop):
    with pytest.raises(JobError, match=r"none after 0\.0 s"):
        prepared(loop).run(ignored)
    runners = [post.runner for post in loop.taken if post.runner is not None]
    assert [runner.policy.spec.name for runner in runners] == ["excite-seed", "reach"]
    assert [type(runner) for runner in runners] == [ThreadRunner, InlineRunner]


def test_an_excitation_that_is_cancelled_before_its_goal_starts_none(loop):
    work = prepared(loop)
    work.end()
    with pytest.raises(JobError, match="cancelled before it began"):
        work.run(ignored)
    assert [post.request.kind for post in loop.taken] == ["policy", "policy"]


def test_only_a_refused_policy_is_closed(loop, stalled, monkeypatch):
    def fault(runner):
        return runner.step(np.zeros(8, np.float32), np.full(2, math.nan, np.float32)).fault

    loop.refuse = ("a goal is running",)
    with pytest.raises(JobError, match="a goal is running"):
        prepared(loop).run(ignored)
    assert "its runner is closed" in fault(loop.taken[0].runner)
    monkeypatch.setattr(excitation, "ANSWER_S", 0.05)
    with pytest.raises(JobError, match="did not answer"):
        prepared(stalled).run(ignored)
    (late,) = stalled.inbox.take()  # the loop may still accept it
    assert fault(late.runner) is None
    late.runner.close()
