"""Ctrl-C: what is left, in which state, and exit code 130."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from softarm.daemon.control.records import Mode
from softarm.daemon.logbook import logs


def interrupt(*_):
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("arguments", "patched", "left"),
    [
        (
            ["goal", "run", "--wait"],
            "following.time.sleep",
            "the daemon goes on with the goal; `softarm goal cancel` ends it",
        ),
        (["arm"], "arming.time.sleep", "the daemon goes on arming; `softarm disarm` takes that back"),
        (["disarm"], "arming.time.sleep", "the daemon goes on: it disarms once the arm hangs still"),
        (["events", "--follow"], "events.time.sleep", "the daemon goes on"),
        (["status", "--watch"], "status.time.sleep", "the daemon goes on"),
    ],
)
def test_a_verb_that_waits_for_the_daemon_leaves_it_going(
    softarm, daemon, make_status, monkeypatch, arguments, patched, left
):
    mode = Mode.STOPPING if arguments == ["disarm"] else Mode.ARMING
    status = make_status(mode=mode) | {"warnings": []}
    for verb in ("arm", "disarm", "goal"):
        daemon.on("POST", f"/api/{verb}", status | {"goal": {"number": 3}})
    daemon.on("GET", "/api/status", status)
    daemon.on("GET", "/api/goal", {"state": "running", "number": 3})
    daemon.on("GET", "/api/events?limit=50", {"run": "a", "events": [], "oldest": None, "newest": None})
    monkeypatch.setattr(f"softarm.cli.{patched}", interrupt)
    result = softarm(*arguments)
    assert result.exit_code == 130
    assert result.stderr.endswith(f"\ninterrupted: {left}\n")


@pytest.mark.parametrize(
    ("arguments", "patched", "left"),
    [
        (["evaluate"], "softarm.flights.evaluation.evaluate", "nothing was written"),
        (["plan", "--ceiling"], "softarm.training.trajectory.rows.of_searches", "nothing was written"),
        (["diagnose", "x.mcap"], "softarm.diagnosis.from_files.diagnose_files", "nothing was written"),
        (
            ["blind", "run", "cases", "--answers", "a.json"],
            "softarm.diagnosis.blind.run.run",
            "answers are kept, not frozen; the same command goes on with a.json",
        ),
        (
            ["train", "reach", "--out", "mine"],
            "softarm.training.run.recipe.begin",
            "no checkpoint yet, so nothing to go on with; mine may be deleted",
        ),
        (
            ["train", "--sweep", "a.yaml", "--out", "runs"],
            "softarm.training.run.sweep.load",
            "finished runs are kept in runs; the same command goes on with the others",
        ),
        (["replay", "x.mcap"], "softarm.daemon.logbook.logs.parts", "nothing was changed"),
    ],
)
def test_work_that_is_broken_off_says_what_it_leaves(softarm, monkeypatch, arguments, patched, left):
    monkeypatch.setattr(patched, interrupt)
    result = softarm(*arguments)
    assert (result.exit_code, result.stderr) == (130, f"\ninterrupted: {left}\n")


@pytest.mark.realtime
@pytest.mark.timeout(120)
@pytest.mark.parametrize(
    ("number", "code", "word"), [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 0, "ended")]
)
def test_a_daemon_that_ends_says_how_it_left_the_robot(tmp_path: Path, number: signal.Signals, code: int, word: str):
    config = tmp_path / "arm.yaml"
    config.write_text(f"api: {{port: 0}}\ncontrol: {{policy: hold}}\nrecorder: {{directory: {tmp_path}}}\n")
    command = [sys.executable, "-m", "softarm.cli.main", "run", "--simulated", "--config", str(config)]
    plain = {**os.environ, "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=plain) as process:
        try:
            recording = next(m[1] for line in process.stdout if (m := re.search(r"recording (\S+)", line)))
            next(line for line in process.stdout if "Ctrl-C ends" in line)
            process.send_signal(number)
            said = process.communicate(timeout=20)[0]
        finally:
            process.kill()
    assert process.returncode == code
    assert said.endswith(f"{word}: the drive is off, the muscle vented; {recording} is closed\n")
    assert logs.read(recording).finished
