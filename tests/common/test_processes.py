"""The process pool: results, errors, killed workers and Ctrl-C; no process remains."""

import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from softarm.common import processes
from softarm.common.processes import WorkClock, WorkerDied, _Lines, as_they_come, bar, left_s
from tests.common.work import killed, noted, squared, surroundings
from tests.processes import gone, until

ROOT = Path(__file__).parents[2]
# A program with a busy and a waiting worker; each writes its process number.
HANGING = """
import os, signal, sys, time
from softarm.common.processes import as_they_come

def work(job):
    folder, seconds = job
    open(f"{folder}/{os.getpid()}", "w").close()
    time.sleep(seconds)

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell in the background has it ignored
    list(as_they_come(work, [(sys.argv[1], 100), (sys.argv[1], 0)], 2))
"""


@pytest.fixture(autouse=True)
def workers_find_this_file(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))


def test_one_process_is_this_one_and_works_in_order(tmp_path):
    begun = as_they_come(partial(noted, tmp_path), [5, 3, 4], 1)
    assert next(begun) == (5, 5)
    assert [path.name for path in tmp_path.iterdir()] == ["5"]  # lazily: the next begins when it is asked for
    assert list(begun) == [(3, 3), (4, 4)]


def test_workers_are_others_with_a_thread_each_which_ctrl_c_ends_without_a_word(monkeypatch):
    """This process keeps its own number of threads."""
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
    found = dict(as_they_come(surroundings, [2, 3], 2))
    assert set(found) == {2, 3}
    assert os.getpid() not in {pid for pid, _, _ in found.values()}
    assert {(threads, handler) for _, threads, handler in found.values()} == {("1", signal.SIG_DFL)}
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "NUMBA_NUM_THREADS" not in os.environ


@pytest.mark.parametrize("count", [1, 2])
def test_errors_of_the_work_are_passed_on(count):
    with pytest.raises(ValueError, match="-1 is negative"):
        list(as_they_come(squared, [0, -1, 2], count))


def test_a_killed_worker_is_reported():
    with pytest.raises(WorkerDied, match="start again with fewer processes"):
        list(as_they_come(killed, [0, 1, 2, 3], 2))


def test_closing_the_iterator_cancels_the_remaining_jobs(tmp_path):
    for _ in as_they_come(partial(noted, tmp_path), list(range(400)), 2):
        break
    there = len(list(tmp_path.iterdir()))
    assert 1 <= there < 400


@pytest.mark.parametrize(
    ("kill", "end"),
    [(os.kill, signal.SIGINT), (os.killpg, signal.SIGINT), (os.kill, signal.SIGKILL)],
    ids=["interrupted alone", "Ctrl-C", "killed"],
)
def test_workers_end_with_the_program_that_started_them(tmp_path, kill, end):
    script, folder = tmp_path / "hanging.py", tmp_path / "pids"
    script.write_text(HANGING)
    folder.mkdir()
    with subprocess.Popen(
        [sys.executable, str(script), str(folder)],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,  # a group of its own, as a shell gives it
    ) as program:
        try:
            until(lambda: len(list(folder.iterdir())) == 2)
            kill(program.pid, end)
            said = program.communicate(timeout=60)[1]
            until(lambda: all(gone(int(path.name)) for path in folder.iterdir()))
        finally:
            program.kill()
    assert program.returncode != 0
    assert said.count("Traceback") <= 1  # the program's own


def test_a_short_bar_without_a_terminal_prints_nothing(capsys):
    with processes.bar("working", 3) as bar:
        bar.advance()
        bar.show(2, text="still working")
    assert capsys.readouterr() == ("", "")


def test_a_bar_without_a_terminal_prints_lines_with_the_remaining_time():
    said, clock = [], iter([0.0, 0.5, 2.0, 4.0, 12.0, 14.0, 30.0])
    lines = _Lines(said.append, lambda: next(clock))
    for share in (0.0, 0.0, 0.1, 0.25, 0.3, 0.75):
        lines.update("flying", share)
    assert said == ["flying ...", "flying (25 %, about 36 s left)", "flying (75 %, about 10 s left)"]


def test_the_remaining_time_of_resumed_work_counts_from_where_it_resumed():
    said, clock = [], iter([0.0, 10.0])
    _Lines(said.append, lambda: next(clock)).update("training", 0.7, begun=0.6)
    assert said == ["training (70 %, about 30 s left)"]


def test_the_remaining_time_leaves_compiling_out():
    said, now_s = [], [0.0]
    clock = WorkClock(lambda: now_s[0])
    lines = _Lines(said.append, clock)
    now_s[0] = 5.0
    clock.begin_leaving_out()
    clock.begin_leaving_out()
    now_s[0] = 25.0
    clock.end_leaving_out()
    now_s[0] = 45.0
    clock.end_leaving_out()
    now_s[0] = 50.0
    lines.update("simulating", 0.25)
    assert said == ["simulating (25 %, about 30 s left)"]


def test_long_work_without_reports_prints_one_line_without_a_terminal(capsys, monkeypatch):
    monkeypatch.setattr(processes, "FIRST_LINE_S", 0.05)
    with bar("flying") as shown:
        shown.report("flying, 1 of 2 flights", 0.0)
        said = []
        until(lambda: said.append(capsys.readouterr().err) or any(said))
    assert "".join(said) == "flying, 1 of 2 flights ...\n"
    assert capsys.readouterr().err == ""


def test_the_remaining_time_grows_while_a_step_reports_nothing():
    assert [left_s(elapsed_s, 0.25) for elapsed_s in (10.0, 20.0)] == [30.0, 60.0]
    assert left_s(10.0, 1.5) == 0.0


def test_a_bar_on_a_terminal_shows_the_remaining_time(monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")
    with bar("working", total=4, done=1) as shown:
        shown.advance(3)
    last = capsys.readouterr().err.split("working")[-1]
    assert last.count("0:00:00") == 2  # elapsed and remaining
