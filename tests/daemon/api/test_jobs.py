"""Jobs over the API: replay, diagnosis and excitation, one at a time."""

import os
import shutil
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from softarm.cli.main import main
from softarm.daemon.control.records import Mode
from softarm.daemon.logbook.recorder import Recorder
from softarm.daemon.runtime import jobs as jobs_module
from softarm.daemon.runtime import verb_process
from softarm.daemon.runtime.jobs import Done, JobError, Jobs
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal, GoalStatus
from tests.processes import gone, until

FLIGHT = Path(__file__).parents[2] / "data" / "flight.mcap"
REPLAY = {"kind": "replay", "log": "real.mcap"}


@pytest.fixture
def config(tmp_path):
    shutil.copy(FLIGHT, tmp_path / "real.mcap")
    (tmp_path / "noise.mcap").write_bytes(os.urandom(5000))
    return Config(recorder={"directory": tmp_path}, api={"reports": tmp_path / "reports"})


@pytest.fixture
def jobs():
    made = Jobs()
    yield made
    made.stop()


@pytest.fixture
def client(loop, app, client_of, config, jobs):
    return client_of(app(loop, config, jobs=jobs, recorder=Recorder(config)))


def ended(client) -> dict:
    until(lambda: client.get("/api/jobs").json()["jobs"][0]["state"] != "running", "the end of a job")
    return client.get("/api/jobs").json()["jobs"][0]


@pytest.fixture
def pausing(verb_runs):
    """Replace every verb by a process that prints a line of progress and waits."""
    verb_runs(
        "sys.stderr.write(f'fitting (40 %, about 9 s left) {os.getpid()}\\n'); sys.stderr.flush(); signal.pause()"
    )


@pytest.mark.slow
def test_a_replay_answers_as_the_command_line_does(client, config):
    started = client.post("/api/jobs", json=REPLAY)
    assert (started.status_code, started.json()["state"]) == (200, "running")
    job = ended(client)
    verb = CliRunner().invoke(main, ["logs", "replay", str(config.recorder.directory / "real.mcap")])
    assert (job["state"] == "done") is (verb.exit_code == 0)
    assert "\n".join(job["sentences"]) == verb.stdout.strip()


def test_a_failed_verb_is_a_failed_job_with_its_last_message(client, config, verb_runs):
    verb = CliRunner().invoke(main, ["logs", "replay", str(config.recorder.directory / "noise.mcap")])
    assert (verb.exit_code, "noise.mcap" in verb.stderr) == (verb_process.FAILED, True)
    verb_runs("print('one tick'); sys.exit('no log')")
    client.post("/api/jobs", json={"kind": "replay", "log": "noise.mcap"})
    job = ended(client)
    assert (job["state"], job["sentences"]) == ("failed", ["one tick", "no log"])


def test_a_job_shows_its_progress_and_excludes_others_until_it_is_cancelled(client, jobs, pausing):
    client.post("/api/jobs", json={"kind": "diagnose", "logs": ["real.mcap"]})
    until(lambda: jobs.entries[0].share == 0.4, "a line of progress")
    pid = int(jobs.entries[0].progress.rpartition(" ")[2])
    busy = client.post("/api/jobs", json=REPLAY)
    assert (busy.status_code, busy.json()["reasons"][0]) == (
        409,
        "job 1 (diagnosis of real.mcap) is running: wait for its end or cancel it",
    )
    assert client.request("DELETE", "/api/jobs/1").status_code == 200
    job = ended(client)
    assert (job["state"], job["report"], job["sentences"]) == ("cancelled", None, [])
    assert gone(pid)
    assert client.request("DELETE", "/api/jobs/7").status_code == 404
    assert client.post("/api/jobs", json=REPLAY).json()["number"] == 2


def test_a_job_ends_with_the_daemon(client, jobs, pausing):
    client.post("/api/jobs", json=REPLAY)
    until(lambda: jobs.entries[0].progress)
    pid = int(jobs.entries[0].progress.rpartition(" ")[2])
    jobs.stop()
    until(lambda: gone(pid))


class Raises:
    """Work that fails in a given way."""

    def __init__(self, error):
        self.error = error

    def run(self, progress):
        if self.error is None:
            return Done(("well",))
        raise self.error

    def end(self):
        pass


@pytest.mark.parametrize(
    ("error", "state", "sentence"),
    [
        (None, "done", "well"),
        (JobError("the robot stopped"), "failed", "the robot stopped"),
        (ValueError("3"), "failed", "a defect in softarm: ValueError: 3; see the service's log"),
    ],
)
def test_a_job_keeps_its_result(jobs, error, state, sentence):
    jobs.start("replay", "replay of x", Raises(error))
    until(lambda: jobs.entries[0].ended)
    assert (jobs.entries[0].state, jobs.entries[0].sentences) == (state, (sentence,))


class SlowLock:
    """Lock after whose release another thread runs first, as on a busy computer."""

    def __init__(self):
        self._lock = threading.Lock()

    def __enter__(self):
        self._lock.acquire()

    def __exit__(self, *_):
        self._lock.release()
        time.sleep(0.01)


def test_a_job_that_has_ended_excludes_no_other(monkeypatch):
    monkeypatch.setattr(jobs_module, "threading", SimpleNamespace(Lock=SlowLock, Thread=threading.Thread))
    jobs = Jobs()
    for number in range(5):
        jobs.start("replay", f"replay {number}", Raises(None))
        until(lambda: jobs.entries[0].state == "done")


WRONG = (
    ({"kind": "excite", "excitation": "sed"}, 404, "no excitation 'sed'; did you mean seed?"),
    ({"kind": "replay", "log": "../x.mcap"}, 404, "no log '../x.mcap'"),
    ({"kind": "diagnose", "logs": []}, 422, "logs: must be a list of one to 20 texts; GET /api/logs lists"),
    ({"kind": "diagnose", "logs": [3]}, 422, "logs: must be a list of one to 20 texts"),
    ({"kind": "excite"}, 422, "excitation: missing; must be text; GET /api/jobs lists the names"),
    ({"kind": "dance"}, 422, "kind: must be 'excite', 'diagnose' or 'replay'"),
)


def test_a_wrong_job_is_refused_with_the_allowed_values(client):
    for body, status, reason in WRONG:
        answer = client.post("/api/jobs", json=body)
        assert (answer.status_code, answer.json()["reasons"][0][: len(reason)]) == (status, reason)


def test_a_diagnosis_without_a_place_for_its_report_is_refused(client, config):
    config.api.reports.write_text("a file")
    answer = client.post("/api/jobs", json={"kind": "diagnose", "logs": ["real.mcap"]})
    assert answer.status_code == 409
    (reason,) = answer.json()["reasons"]
    assert reason.startswith(f"api.reports {config.api.reports}: no report can be written there (File exists); name ")


def test_a_verbs_process_has_a_low_priority(verb_runs):
    verb_runs("print(os.nice(0), os.sched_getscheduler(0), open('/proc/self/oom_score_adj').read())")
    done = subprocess.run(
        [sys.executable, "-c", verb_process._PROGRAM, "5"], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == [str(min(19, os.nice(0) + 10)), str(os.SCHED_OTHER), "1000"]


NEEDED = (
    (Mode.DISARMED, "none", Path("x.mcap"), "the arm is disarmed: arm it first"),
    (Mode.ARMED, "running", Path("x.mcap"), "a goal is running: wait for its end or cancel it"),
    (Mode.ARMED, "none", None, "recording is switched off: set recorder.enabled to true"),
)


def test_an_excitation_needs_what_a_goal_needs(stalled, app, client_of, config):
    recording = Recorder(config)
    client = client_of(app(stalled, config, recorder=recording))
    for mode, state, recording.path, reason in NEEDED:
        stalled.outputs = replace(stalled.outputs, mode=mode, goal=GoalStatus(Goal("reach", -0.2, 0.6), state))
        answer = client.post("/api/jobs", json={"kind": "excite", "excitation": "seed"})
        assert answer.status_code == 409
        assert answer.json()["reasons"][0].startswith(reason)
        assert not stalled.inbox.take()
