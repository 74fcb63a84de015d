"""Sweeps on a local Ray instance, as `softarm train --sweep FILE --ray local` starts one."""

import csv
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

import softarm

pytest.importorskip("ray")


ROOT = Path(softarm.__file__).parents[1]
ENOUGH_S = 600.0  # ends a hanging test; no test depends on the speed of the machine
# Ray itself starts for a quarter of a minute; test_sweep.py proves the same with a stand-in for Ray.
pytestmark = [pytest.mark.slow, pytest.mark.prove, pytest.mark.timeout(1800)]
FILE = """
seeds: [1]
base: {task: reach, settings: {run.robots: 16, run.validate_every: 4, run.validation_trials: 8}}
runs:
  short: {frames: 256}
  long: {frames: 10240}
"""


@pytest.fixture
def apart(monkeypatch):
    """Give Ray a folder with a name short enough for its sockets, and wait for the end of its processes."""
    with tempfile.TemporaryDirectory(prefix="ray-") as folder:
        monkeypatch.setenv("RAY_TMPDIR", folder)
        monkeypatch.setenv("RAY_AUTH_MODE", "token")
        monkeypatch.setenv("RAY_AUTH_TOKEN", "f" * 64)  # or Ray creates a token in the home folder
        monkeypatch.setenv("PYTHONPATH", str(ROOT))
        yield Path(folder)
        await_true(lambda: not processes(folder), "Ray's processes to end")


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "sweep.yaml"
    path.write_text(FILE)
    return path


def processes(folder):
    """Return the processes of the Ray instance with this folder."""
    found = []
    for each in Path("/proc").glob("[0-9]*"):
        try:
            state = (each / "stat").read_text().rpartition(")")[2].split()[0]
            if f"RAY_TMPDIR={folder}".encode() in (each / "environ").read_bytes() and state != "Z":
                found.append(int(each.name))
        except OSError:
            continue  # ended meanwhile, or not ours
    return sorted(set(found) - {os.getpid()})


def await_true(condition, what):
    deadline = time.monotonic() + ENOUGH_S
    while not condition():
        assert time.monotonic() < deadline, f"waited {ENOUGH_S:.0f} s for {what}"
        time.sleep(0.02)


def command(file, out):
    arguments = ("train", "--sweep", str(file), "--out", str(out), "--ray", "local")
    return [sys.executable, "-m", "softarm.cli.main", *arguments]


def frames(folder):
    with (folder / "learning_curve.csv").open() as opened:
        return [int(float(row["frames"])) for row in csv.DictReader(opened)]


def test_a_killed_sweep_skips_finished_runs_and_continues_the_others(file, tmp_path, apart):
    out = tmp_path / "runs"
    short, long = out / "short" / "seed-1", out / "long" / "seed-1"
    first = subprocess.Popen(command(file, out), cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        await_true(
            lambda: first.poll() is not None or ((short / "result.json").exists() and (long / "latest.pt").exists()),
            "one run to finish and the other to begin",
        )
    finally:
        first.send_signal(signal.SIGKILL)
        first.wait()
    await_true(lambda: not processes(apart), "the killed sweep's processes to end")
    assert not (long / "result.json").exists()
    finished = (short / "result.json").stat().st_mtime_ns
    before = frames(long)
    assert before

    again = subprocess.run(command(file, out), cwd=ROOT, capture_output=True, text=True, timeout=ENOUGH_S)
    assert again.returncode == 0, again.stderr
    assert "Traceback" not in again.stderr
    assert (short / "result.json").stat().st_mtime_ns == finished
    assert "short, seed 1" not in again.stdout
    assert "long, seed 1: validation" in again.stdout
    whole = frames(long)
    assert whole == sorted(set(whole))  # continued, not restarted
    assert whole[-1] == 10240
    assert {each["name"] for each in json.loads((out / "results.json").read_text())} == {"short", "long"}


@pytest.mark.usefixtures("apart")
def test_a_failed_run_is_reported_with_its_own_message(file, tmp_path):
    out = tmp_path / "runs"
    for name in ("short", "long"):
        (out / name / "seed-1").mkdir(parents=True)
        (out / name / "seed-1" / "latest.pt").write_bytes(b"half a checkp")
    failed = subprocess.run(command(file, out), cwd=ROOT, capture_output=True, text=True, timeout=ENOUGH_S)
    assert failed.returncode == 1
    (line,) = (line for line in failed.stderr.splitlines() if ", seed 1: " in line)
    assert "seed 1: CheckpointError: " in line
    assert "latest.pt" in line
    assert "Traceback" not in failed.stderr + failed.stdout
