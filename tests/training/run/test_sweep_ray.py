"""Sweeps on a local Ray instance, as `softarm train --sweep FILE --ray local` starts one."""

import csv
import json
import signal
import subprocess
import sys

import pytest

from tests.ray_instance import ENOUGH_S, ROOT, WITH_RAY, apart, await_true, processes

# Ray itself starts for a quarter of a minute; tests/common/test_batch.py proves the same with a stand-in for Ray.
pytestmark = [pytest.mark.slow, pytest.mark.prove, pytest.mark.timeout(1800), WITH_RAY]
FILE = """
seeds: [1]
base: {task: reach, settings: {run.robots: 16, run.validate_every: 4, run.validation_trials: 8}}
runs:
  short: {frames: 256}
  long: {frames: 10240}
"""


@pytest.fixture(name="apart")
def apart_():
    with apart() as folder:
        yield folder


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "sweep.yaml"
    path.write_text(FILE)
    return path


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
    lines = [line for line in failed.stderr.splitlines() if ", seed 1: " in line]
    assert [line.partition(",")[0] for line in lines] == ["short", "long"]  # one failure does not stop the other
    assert all("seed 1: CheckpointError: " in line and "latest.pt" in line for line in lines)
    assert "Traceback" not in failed.stderr + failed.stdout
