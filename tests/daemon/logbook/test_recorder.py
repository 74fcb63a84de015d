"""Recorder: never delays the loop, loses one flush at most in a kill, leaves a valid file."""

import dataclasses
import os
import struct
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from mcap.reader import make_reader

from softarm.daemon.control.records import Inputs, Mode, Outputs, Problems, TickTiming
from softarm.daemon.logbook import folder, logs
from softarm.daemon.logbook.recorder import Recorder, RecorderError
from softarm.daemon.logbook.ticks import TickFile
from softarm.policies.base import PolicySpec
from softarm.recordings import log_file
from softarm.recordings.mcap_file import is_finished
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal, GoalStatus
from softarm.schemas.messages import PressureReading
from tests.daemon.logbook.builders import config, make_tick, recorded, recording, unfinished
from tests.processes import until


def test_a_clean_stop_leaves_a_compressed_file_with_an_index(tmp_path):
    recorder = recorded(config(tmp_path), map(make_tick, range(90)))
    with recorder.path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        topics = {channel.topic for _, channel, _ in reader.iter_messages()}
    assert summary.statistics.message_count == 90 * 7
    assert summary.chunk_indexes[0].compression == "zstd"
    assert topics == {"/mocap", "/pressure", "/rail", "/tick"}
    assert [path.name for path in tmp_path.iterdir()] == [recorder.path.name]


def test_the_head_of_a_log_names_software_computer_and_time(tmp_path):
    settings = config(tmp_path)
    with recording(settings, monotonic_ns=lambda: 1_000, wall_ns=lambda: 1_790_000_000_000_000_000) as recorder:
        pass
    log = logs.read(recorder.path)
    assert Config.model_validate_json(log.metadata["configuration"]["json"]) == settings
    assert log.metadata["clock"]["wall_minus_monotonic_ns"] == str(1_790_000_000_000_000_000 - 1_000)
    assert log.metadata["machine"]["name"] == os.uname().nodename
    assert log.metadata["software"]["python"] == sys.version.split()[0]
    assert {"softarm", "git_revision", "mcap", "numpy"} <= set(log.metadata["software"])
    assert log.metadata["policy"] == {"name": "reach", "description": "swings", "sha256": "ab" * 32}
    assert recorder.path.name == "softarm-20260921T141320Z.mcap"


def test_a_change_of_policy_is_recorded_in_order(tmp_path):
    with recording(config(tmp_path)) as recorder:
        recorder.tick(*make_tick(0))
        recorder.policy(PolicySpec("pid", "the seed's gains"))
        recorder.tick(*make_tick(1))
    assert [policy["name"] for policy in logs.read(recorder.path).policies] == ["reach", "pid"]


def test_two_recorders_in_the_same_second_write_two_files(tmp_path):
    with recording(config(tmp_path), wall_ns=lambda: 0), recording(config(tmp_path), wall_ns=lambda: 0):
        pass
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "softarm-19700101T000000Z-2.mcap",
        "softarm-19700101T000000Z.mcap",
    ]


def test_a_full_queue_drops_and_counts_and_never_blocks(tmp_path, monkeypatch):
    gate, entered = threading.Event(), threading.Event()
    write = TickFile.write

    def slow_disk(self, item):
        entered.set()
        gate.wait(20)
        return write(self, item)

    monkeypatch.setattr(TickFile, "write", slow_disk)
    with recording(config(tmp_path, queue_max=100)) as recorder:
        recorder.tick(*make_tick(0))
        assert entered.wait(20)  # the writer holds one tick and hangs
        for number in range(1, 151):
            recorder.tick(*make_tick(number))
        assert recorder.dropped == 50
        gate.set()
    assert [o.tick for _, o in logs.read(recorder.path).ticks()] == list(range(101))
    assert recorder.problem is None


def test_a_directory_that_cannot_be_made_is_refused_with_the_next_step(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(RecorderError, match=r"file/logs: .*make it writable for uid .*set recorder.enabled: false"):
        Recorder(config(tmp_path / "file" / "logs")).start()


def test_a_full_disk_is_refused_at_start(tmp_path, monkeypatch):
    monkeypatch.setattr("softarm.daemon.logbook.folder.FREE_MIN_BYTES", 1 << 62)
    with pytest.raises(RecorderError, match=r"the disk is full .* delete old logs or use a directory"):
        Recorder(config(tmp_path)).start()
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def disk(monkeypatch):
    """Return a disk that can be full and is checked often."""
    full = threading.Event()
    flush, new_log = TickFile.flush, folder.new_log

    def on_the_disk(function):
        def guarded(*arguments):
            if full.is_set():
                raise OSError(28, "No space left on device")
            return function(*arguments)

        return guarded

    monkeypatch.setattr(TickFile, "flush", on_the_disk(flush))
    monkeypatch.setattr(folder, "new_log", on_the_disk(new_log))
    monkeypatch.setattr("softarm.daemon.logbook.recorder.RETRY_S", 0.01)
    return full


def test_a_full_disk_ends_the_log_and_recording_resumes_in_a_new_one(tmp_path, disk):
    with recording(config(tmp_path)) as recorder:
        first = recorder.path
        recorder.tick(*make_tick(0))
        until(lambda: logs.read(first).t_last_ns is not None, "the first tick in the file")
        disk.set()
        until(lambda: recorder.problem is not None, "the problem")
        for words in ("the log ends here", "delete old logs", "recording continues by itself"):
            assert words in recorder.problem
        recorder.tick(*flown(1))
        until(lambda: recorder.history.entries, "the event is still reported")
        assert recorder.history.entries[0].text == "disarmed → armed"
        recorder.policy(PolicySpec("pid", "the seed's gains"))
        recorder.done("log", "deleted an old log", "the bench")
        until(lambda: len(recorder.history.entries) == 2, "the action, and with it the policy queued before it")
        disk.clear()
        until(lambda: recorder.problem is None, "the new log")
        recorder.tick(*make_tick(2))
        until(lambda: logs.read(recorder.path).t_last_ns is not None, "its first tick")
        disk.set()
        until(lambda: recorder.problem is not None, "the problem")
    assert recorder.path != first
    assert recorder.dropped == 1
    log = logs.read(recorder.path)
    assert [o.tick for _, o in log.ticks()] == [2]
    assert [policy["name"] for policy in log.policies] == ["pid"]
    assert [o.tick for _, o in logs.read(first).ticks()] == [0]


def flown(number: int, goal: str | None = None) -> tuple[Inputs, Outputs, TickTiming]:
    """Return a tick of an armed arm with a goal of this kind; its long text fills a file ten times as fast."""
    inputs, outputs, timing = make_tick(number)
    inputs = dataclasses.replace(inputs, problems=Problems(rail="refused " * 2000))
    status = GoalStatus() if goal is None else GoalStatus(Goal(goal, -0.2, 0.6), "running")
    return inputs, dataclasses.replace(outputs, mode=Mode.ARMED, goal=status), timing


def parts(directory: Path) -> list[list[int]]:
    """Return the ticks of each log in the order of the run."""
    found = sorted(map(logs.read, directory.glob("*.mcap")), key=lambda each: int(each.metadata["run"]["part"]))
    assert len({each.metadata["run"]["id"] for each in found}) == 1
    assert all(each.metadata["policy"]["name"] == "reach" for each in found)
    return [[outputs.tick for _, outputs in each.ticks()] for each in found]


def test_a_long_flight_has_files_of_equal_size_with_every_tick_despite_the_goal_to_hold(tmp_path):
    goals = {number: "hold" if number > 60 else None for number in range(1, 161)}
    recorder = recorded(config(tmp_path, file_max_mb=1), (flown(*each) for each in goals.items()))
    ticks = parts(tmp_path)
    assert len(ticks) >= 3
    assert [number for part in ticks for number in part] == list(range(1, 161))
    assert all(abs(len(part) - len(ticks[0])) < 3 for part in ticks[:-1])
    assert recorder.dropped == 0


@pytest.mark.slow
def test_a_full_file_waits_a_limited_time_for_the_end_of_a_goal(tmp_path):
    # A goal begins before the file is full, and ends a little after.
    goals = {number: "reach" if 30 <= number < 140 else None for number in range(1, 151)}
    recorded(config(tmp_path, file_max_mb=1), (flown(*each) for each in goals.items()))
    first, *others = parts(tmp_path)
    assert 30 < len(first) < 140
    full = round(len(first) / 1.1)
    goals = {number: "reach" if 30 <= number < full + 3 else None for number in range(1, 101)}
    recorded(config(tmp_path / "short", file_max_mb=1), (flown(*each) for each in goals.items()))
    assert parts(tmp_path / "short")[0][-1] == full + 3  # the first tick in which no policy flew
    assert [number for part in (first, *others) for number in part] == list(range(1, 151))


@pytest.mark.slow
def test_a_full_file_is_continued_if_no_new_one_can_be_created(tmp_path, disk, monkeypatch):
    # A full file gets few ticks an interval.
    with recording(config(tmp_path, file_max_mb=1, flush_interval_s=0.005)) as recorder:
        first = recorder.path
        new_log = folder.new_log
        monkeypatch.setattr(folder, "new_log", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device")))
        for number in range(1, 91):
            recorder.tick(*flown(number))
        until(lambda: first.stat().st_size > 1_500_000, "a file that is more than full")
        assert (recorder.path, recorder.problem) == (first, None)
        monkeypatch.setattr(folder, "new_log", new_log)
        recorder.tick(*flown(91))
        until(lambda: recorder.path != first, "the next file")
    assert [number for part in parts(tmp_path) for number in part] == list(range(1, 92))


def test_a_tick_that_cannot_be_encoded_is_dropped_and_counted(tmp_path, caplog):
    reading = PressureReading(1, 0.5, False)
    with recording(config(tmp_path)) as recorder:
        for number in range(1, 11):
            inputs, outputs, timing = make_tick(number)
            wrong = {"problems": Problems(rail="\ud800")} if number in (1, 5) else {}
            wrong |= {"mocap": (*inputs.mocap[:2], None, inputs.mocap[3])} if number == 6 else {}
            recorder.tick(dataclasses.replace(inputs, pressure=reading, **wrong), outputs, timing)
    assert (recorder.dropped, recorder.problem) == (3, None)
    ticks = list(logs.read(recorder.path))
    assert [outputs.tick for _, outputs, _ in ticks] == [2, 3, 4, 7, 8, 9, 10]
    assert all(inputs.pressure == reading and len(inputs.mocap) == 4 for inputs, _, _ in ticks)
    assert "tick 1: PydanticSerializationError" in caplog.text
    assert "left out of the log, like 1 before it" in caplog.text


def test_a_disabled_recorder_writes_nothing(tmp_path):
    with recording(config(tmp_path / "logs", enabled=False)) as recorder:
        recorder.tick(*make_tick(0))
        recorder.tick(*flown(1))
    assert recorder.path is None
    assert recorder.dropped == 0
    assert [entry.text for entry in recorder.history.entries] == ["disarmed → armed"]
    assert not (tmp_path / "logs").exists()


def test_the_next_start_finishes_the_log_of_a_killed_daemon(tmp_path):
    left = unfinished(tmp_path / "softarm-20200101T000000Z.mcap", map(make_tick, range(50)))
    (tmp_path / "softarm-20200101T000001Z.mcap").write_bytes(b"rubbish")
    with recording(config(tmp_path)):
        until(lambda: is_finished(left), "the old log")
    assert len(list(logs.read(left).ticks())) == 50
    assert (tmp_path / "softarm-20200101T000001Z.mcap").read_bytes() == b"rubbish"


def test_a_log_being_written_is_not_finished_by_another_daemon(tmp_path):
    with recording(config(tmp_path)) as writer:
        writer.tick(*make_tick(0))
        until(lambda: logs.read(writer.path).t_last_ns is not None, "the first tick in the file")
        assert not log_file.recover(writer.path).finished
        writer.tick(*make_tick(1))
    assert len(list(logs.read(writer.path).ticks())) == 2


CHILD = """
import os, struct, sys, time
from softarm.daemon.logbook.recorder import Recorder
from softarm.daemon.logbook.ticks import TickFile
from softarm.schemas.config import Config
from tests.daemon.logbook.builders import make_tick

queued, written, flush, write = 0, 0, TickFile.flush, TickFile.write

def counted(self, tick):
    global written
    written += 1
    return write(self, tick)

def announced(self):
    flush(self)
    os.write(1, struct.pack("<qq", queued, written))

TickFile.write, TickFile.flush = counted, announced
recorder = Recorder(Config(recorder={"directory": sys.argv[1], "idle_interval_s": 0}))
recorder.start()
while True:
    recorder.tick(*make_tick(queued, time.monotonic_ns()))
    queued += 1
    time.sleep(1 / 30)
"""


@pytest.mark.slow
def test_a_kill_loses_no_more_than_the_last_flush(tmp_path):
    path = os.pathsep.join(filter(None, sys.path))
    command = [sys.executable, "-c", CHILD, str(tmp_path / "logs")]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, env={**os.environ, "PYTHONPATH": path})
    flushes = child.stdout.read(16 * 12)
    child.kill()
    flushes += child.stdout.read()
    child.stdout.close()
    child.wait()
    counts = list(struct.iter_unpack("<qq", flushes))  # of ticks: queued and written
    queued, written = counts[-1]
    log = logs.read(next((tmp_path / "logs").glob("*.mcap")))
    assert len(list(log.ticks())) >= written > 0
    assert len(counts) > queued / 10  # a flush every 50 ms, a tick every 33 ms
    assert not log.finished
    assert log_file.recover(log.path).finished
