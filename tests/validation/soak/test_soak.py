"""Soak tests in lockstep and in real time: what is watched, what is reported, what the command ends with."""

import json
import os
import signal

import pytest
from click.testing import CliRunner

from softarm.common.processes import WorkerDied
from softarm.policies.hold import Hold
from softarm.policies.pid import Pid
from validation.soak import lockstep, page, realtime
from validation.soak.__main__ import main
from validation.soak.clients import Unexpected

DAYS = 0.5 / 24 / 60  # half a minute


class Fails(Pid):
    def step(self, observation, goal):
        raise ValueError("as it was made to")


def kill_itself(*_):
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.fixture(scope="module")
def soaked():
    return lockstep.soak(DAYS, 1, "pid", lambda share: None)


def test_half_a_minute_in_lockstep_flies_goals_without_a_stop(soaked):
    assert soaked.unexpected == []
    assert soaked.counts["goals"] > 5
    assert soaked.cart_max_m < 0.25
    assert len(soaked.samples) == 15
    assert soaked.samples[-1].day == pytest.approx(DAYS, rel=0.01)
    assert soaked.slopes.keys() == lockstep.ALLOWED.keys()


def test_an_unrequested_stop_is_reported(monkeypatch):
    monkeypatch.setattr(lockstep.registry, "load", lambda name: Fails())
    stepped = lockstep.soak(DAYS / 10, 1, "pid", lambda share: None)
    assert "the policy failed" in stepped.unexpected[0].what
    monkeypatch.setattr(lockstep.registry, "load", lambda name: Hold())
    assert "does not move to targets" in lockstep.soak(DAYS / 10, 1, "hold", lambda share: None).unexpected[0].what
    assert any("in lockstep: after" in line for line in page.problems(None, stepped))


def test_a_stop_is_reported_with_its_log():
    odd = [Unexpected(7.0, "stopped: for nothing", "logs/one.mcap")]
    real = realtime.Soaked(1, 1.0, 0.8, [], {}, {"goals": 3}, odd, 0.2, 12.0)
    assert page.problems(real, None) == ["in real time: after 7 s: stopped: for nothing (log: logs/one.mcap)"]


def test_a_run_too_short_to_decide_exits_with_1_unless_allowed(tmp_path):
    kept = tmp_path / "soak.json"
    short = ["--hours", "0", "--lockstep-days", "0.00002", "--policy", "pid", "--json", str(kept)]
    assert CliRunner().invoke(main, [*short, "--allow-undecided"]).exit_code == 0
    done = CliRunner().invoke(main, short)
    assert done.exit_code == 1
    assert "too short to decide" in done.output
    assert json.loads(kept.read_text())["real_time"] is None
    assert CliRunner().invoke(main, ["--hours", "0"]).exit_code == 2


def test_a_killed_process_in_lockstep_is_stated(monkeypatch, tmp_path):
    monkeypatch.setattr(lockstep, "_step", kill_itself)
    monkeypatch.setattr(realtime, "soak", lambda *_: None)
    with pytest.raises(WorkerDied, match=r"ended early \(exit code -9"):
        lockstep.soak_both(1.0, DAYS, 1, "pid", tmp_path, lambda what, share: None)


@pytest.mark.prove
@pytest.mark.realtime
def test_a_few_seconds_in_real_time_fly_under_load(tmp_path):
    seconds = 20
    soaked = realtime.soak(seconds / 3600, 5, tmp_path, lambda what, share: None)
    late = ("stopped: ", "softarm run: ERROR softarm.drivers.rail")  # which on a busy machine are the machine's
    assert [one for one in soaked.unexpected if not one.what.startswith(late)] == []
    assert soaked.counts["goals"] >= 1
    assert sum(n for what, n in soaked.counts.items() if what.startswith("answer: ")) > seconds
    assert len(soaked.samples) > seconds / 4
    assert soaked.samples[-1].memory_mb > 20
    assert soaked.logs_max_mb > 0
