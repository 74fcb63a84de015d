"""Tests of Ctrl-C: its message and exit code 130."""

import signal
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from softarm.daemon.control.records import Mode
from softarm.daemon.logbook import logs
from tests.processes import WAIT_S, running, said


def interrupt(*_):
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("line", "patched", "left"),
    [
        ("goal run --wait", "operate.goal", "the daemon continues with the goal; `softarm goal cancel` ends it"),
        ("arm", "operate.arming", "the daemon continues to arm; `softarm disarm` reverts that"),
        ("disarm", "operate.arming", "the daemon keeps running and disarms once the arm is still"),
        ("events --follow", "recordings.events", "the daemon keeps running"),
        ("status --watch", "operate.status", "the daemon keeps running"),
    ],
)
def test_ctrl_c_while_waiting_leaves_the_daemon_running(softarm, daemon, make_status, monkeypatch, line, patched, left):
    mode = Mode.STOPPING if line == "disarm" else Mode.ARMING
    status = make_status(mode=mode) | {"warnings": []}
    for verb in ("arm", "disarm", "goal"):
        daemon.on("POST", f"/api/{verb}", status | {"goal": {"number": 3}})
    daemon.on("GET", "/api/status", status)
    daemon.on("GET", "/api/goal", {"state": "running", "number": 3})
    daemon.on("GET", "/api/events?limit=50", {"run": "a", "events": [], "oldest": None, "newest": None})
    # Only this module's clock: a thread of another test may sleep meanwhile.
    clock = SimpleNamespace(sleep=interrupt, monotonic=time.monotonic)
    monkeypatch.setattr(f"softarm.cli.{patched}.time", clock)
    result = softarm(*line.split())
    assert result.exit_code == 130
    assert result.stderr.endswith(f"\ninterrupted: {left}\n")


@pytest.mark.parametrize(
    ("line", "patched", "left"),
    [
        ("evaluate", "evaluation.runner.evaluate", "nothing was written"),
        ("dev plan", "training.trajectory.planner.plan", "nothing was written"),
        ("diagnose x.mcap", "diagnosis.diagnose.diagnose_files", "nothing was written"),
        ("train reach --out mine", "training.run.recipe.begin", "no checkpoint was written yet; start again"),
        ("train --sweep a.yaml --out runs", "training.run.sweep.load", "finished runs are kept in runs; the same"),
        ("logs replay x.mcap", "daemon.logbook.logs.parts", "nothing was changed"),
    ],
)
def test_ctrl_c_during_work_reports_what_is_kept(softarm, monkeypatch, line, patched, left):
    monkeypatch.setattr(f"softarm.{patched}", interrupt)
    result = softarm(*line.split())
    assert result.exit_code == 130
    assert result.stderr.startswith(f"\ninterrupted: {left}")


@pytest.mark.slow
def test_an_interrupted_daemon_reports_the_state_of_the_robot(tmp_path: Path):
    config = tmp_path / "arm.yaml"
    config.write_text(f"api: {{port: 0}}\ncontrol: {{policy: hold}}\nrecorder: {{directory: {tmp_path}}}\n")
    with running("run", "--simulated", "--config", config) as process:
        recording = said(process, r"recording (\S+)")
        said(process, "(Ctrl-C ends)")
        process.send_signal(signal.SIGINT)
        output = process.communicate(timeout=WAIT_S)[0]
    assert process.returncode == 130
    assert output.endswith(f"interrupted: the drive is off, the muscle vented; {recording} is closed\n")
    assert logs.read(recording).finished
