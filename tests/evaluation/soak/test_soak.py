"""A minute of lockstep and some seconds of real time: what is watched, what is reported, what the command ends with."""

import json

import pytest
from click.testing import CliRunner

from softarm.cli.main import main
from softarm.evaluation.soak import lockstep, page, realtime
from softarm.evaluation.soak.clients import Unexpected
from softarm.evaluation.soak.growth import Slope
from softarm.policies.hold import Hold
from softarm.policies.pid import Pid

MINUTE = 1 / 24 / 60  # of a day


class Fails(Pid):
    def step(self, observation, goal):
        raise ValueError("as it was made to")


@pytest.fixture(scope="module")
def minute():
    return lockstep.soak(MINUTE, 1, "pid", lambda share: None)


def test_a_minute_in_lockstep_flies_goals_without_a_stop(minute):
    assert minute.unexpected == []
    assert minute.counts["goals"] > 10
    assert minute.cart_max_m < 0.25
    assert len(minute.samples) == 30
    assert minute.samples[-1].day == pytest.approx(MINUTE, rel=0.01)
    assert minute.slopes.keys() == lockstep.ALLOWED.keys()


@pytest.mark.prove
def test_after_the_real_time_the_share_of_lockstep_is_shown(tmp_path, monkeypatch):
    monkeypatch.setattr(lockstep.realtime, "soak", lambda *_: None)
    monkeypatch.setattr(lockstep, "POLL_S", 0.01)
    seen = []
    _, stepped = lockstep.soak_both(
        1.0, MINUTE / 4, 0, "pid", tmp_path, lambda doing, share: seen.append((doing, share))
    )
    assert stepped.counts
    assert {doing for doing, _ in seen} == {"in lockstep"}
    assert 0 < max(share for _, share in seen) <= 1
    assert seen == sorted(seen)


def test_an_unrequested_stop_is_reported(monkeypatch):
    monkeypatch.setattr(lockstep.registry, "load", lambda name: Fails())
    stepped = lockstep.soak(MINUTE / 20, 1, "pid", lambda share: None)
    assert "the policy failed" in stepped.unexpected[0].what
    monkeypatch.setattr(lockstep.registry, "load", lambda name: Hold())
    assert "does not move to targets" in lockstep.soak(MINUTE / 20, 1, "hold", lambda share: None).unexpected[0].what
    assert any("in lockstep: after" in line for line in page.problems(None, stepped))


def test_page_and_figures_contain_the_findings(minute):
    grown = {name: Slope(9.0, 8.0, 10.0, 1.0) for name in realtime.ALLOWED}
    samples = [realtime.Sample(0.1 * n, 100.0 + n, 40, 12, 17.0, 0.2, 0, 3.0) for n in range(10)]
    odd = [Unexpected(7.0, "stopped: <b>for nothing</b>", "logs/one.mcap")]
    real = realtime.Soaked(1, 1.0, 0.8, samples, grown, {"goals": 3}, odd, 0.2, 12.0)
    reported = page.problems(real, None)
    assert reported[0] == "in real time: memory (MB) grows: 9 per hour (8 to 10), allowed 1"
    assert reported[-1] == "in real time: after 7 s: stopped: <b>for nothing</b> (log: logs/one.mcap)"
    text = page.html(real, minute, "softarm dev soak")
    assert "&lt;b&gt;for nothing" in text
    assert text.count("<svg") == 2
    figures = json.loads(json.dumps(page.figures(real, minute)))
    assert figures["real_time"]["slopes"]["memory_mb"]["verdict"] == "grows"
    assert figures["real_time"]["samples"]["rows"][9][:2] == [0.9, 109.0]
    assert figures["lockstep"]["counts"] == minute.counts


def test_a_run_too_short_to_decide_exits_with_1_unless_allowed(tmp_path):
    kept = tmp_path / "soak.json"
    short = ["dev", "soak", "--hours", "0", "--lockstep-days", "0.00002", "--policy", "pid", "--json", str(kept)]
    assert CliRunner().invoke(main, [*short, "--allow-undecided"]).exit_code == 0
    done = CliRunner().invoke(main, short)
    assert done.exit_code == 1
    assert "too short to decide" in done.output
    assert json.loads(kept.read_text())["real_time"] is None
    assert CliRunner().invoke(main, ["dev", "soak", "--hours", "0"]).exit_code == 2


def test_a_folder_that_holds_logs_is_refused(tmp_path):
    (tmp_path / "old.mcap").write_bytes(b"")
    done = CliRunner().invoke(main, ["dev", "soak", "--logs", str(tmp_path)])
    assert (done.exit_code, "is not empty" in done.output) == (1, True)


@pytest.mark.prove
@pytest.mark.realtime
@pytest.mark.parametrize("seconds", [7, pytest.param(20, marks=pytest.mark.prove)])
def test_a_few_seconds_in_real_time_fly_under_load(tmp_path, seconds):
    soaked = realtime.soak(seconds / 3600, 5, tmp_path, lambda what, share: None)
    late = ("stopped: ", "softarm run: ERROR softarm.drivers.rail")  # which on a busy machine are the machine's
    assert [one for one in soaked.unexpected if not one.what.startswith(late)] == []
    assert soaked.counts["goals"] >= 1
    assert sum(n for what, n in soaked.counts.items() if what.startswith("answer: ")) > seconds
    assert len(soaked.samples) > seconds / 4
    assert soaked.samples[-1].memory_mb > 20
    assert soaked.logs_max_mb > 0
