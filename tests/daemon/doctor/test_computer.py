"""Findings of the doctor on scheduling, clocks and disk, and its reading of this computer."""

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest

from softarm.common.finding import State
from softarm.daemon.doctor import clocks, disk, scheduling
from softarm.daemon.doctor.clocks import Clocks
from softarm.daemon.doctor.disk import Disk
from softarm.daemon.doctor.scheduling import Scheduling
from softarm.recordings.log_file import listing
from softarm.schemas.config import Recorder
from softarm.schemas.log import LogEntry

QUICK = Scheduling(20, True, float("inf"), 4, 0.5, frozenset({"performance"}), (0.1,) * 100)
SET = Clocks(1e-5, 0.5, True, 0.01, "tsc")
ROOMY = Disk(Path("/logs"), True, True, 50_000_000_000, 200e6, 5.0, 100e3)


def states(findings):
    return {each.name: each.state for each in findings}


FINE = {scheduling: QUICK, clocks: SET, disk: ROOMY}


def test_a_fast_computer_with_all_permissions_has_no_findings():
    for part, facts in FINE.items():
        assert set(states(part.judge(facts)).values()) == {State.OK}


@pytest.mark.parametrize(
    ("part", "change", "name", "state"),
    [
        (scheduling, {"granted": False}, "real-time priority", State.WARNING),
        (scheduling, {"priority": 0}, "real-time priority", State.WARNING),
        (scheduling, {"memlock_bytes": 8e6}, "memory lock", State.WARNING),
        (scheduling, {"cores": 1}, "cores", State.WARNING),
        (scheduling, {"load": 4.5}, "cores", State.WARNING),
        (scheduling, {"governors": frozenset({"powersave", "performance"})}, "governor", State.WARNING),
        (scheduling, {"late_ms": (0.1,) * 90 + (5.0,) * 10}, "timers", State.WARNING),
        (scheduling, {"late_ms": (0.1,) * 90 + (15.0,) * 10}, "timers", State.PROBLEM),
        (scheduling, {"late_ms": ()}, "timers", State.PROBLEM),
        (clocks, {"moved_s": -0.3}, "clock", State.WARNING),
        (clocks, {"synchronised": False}, "time of day", State.WARNING),
        (clocks, {"source": "hpet"}, "clock source", State.WARNING),
        (disk, {"writable": False}, "logs", State.PROBLEM),
        (disk, {"free_bytes": 50_000_000}, "logs", State.PROBLEM),
        (disk, {"free_bytes": 5_000_000_000}, "logs", State.WARNING),
        (disk, {"free_bytes": 5_000_000_000, "bounded": True}, "logs", State.OK),
        (disk, {"bytes_s": 500e3}, "disk's speed", State.WARNING),
        (disk, {"bytes_s": 50e3}, "disk's speed", State.PROBLEM),
        (disk, {"flush_ms": 300.0}, "disk's speed", State.WARNING),
        (disk, {"flush_ms": 3000.0}, "disk's speed", State.PROBLEM),
        (disk, {"bytes_s": None, "flush_ms": None}, "disk's speed", State.OK),
    ],
)
def test_each_fault_of_the_computer_is_one_finding(part, change, name, state):
    findings = states(part.judge(replace(FINE[part], **change)))
    assert findings.pop(name) is state
    assert set(findings.values()) <= {State.OK}


def test_days_left_follow_the_rate_of_existing_logs():
    figure = next(each.figure for each in disk.judge(ROOMY) if each.name == "logs")
    assert "17 days of 8 h at 100 kB/s, the rate of its logs" in figure  # 50 GB / (100 kB/s x 28,800 s)


def test_a_disabled_recorder_is_not_checked():
    assert states(disk.judge(replace(ROOMY, enabled=False, writable=False))) == {"logs": State.OK}


def test_this_computers_facts_are_read():
    slept = scheduling.look(0, seconds=0.3)
    assert 1 <= len(slept.late_ms) <= 149
    assert min(slept.late_ms) >= 0.0
    assert slept.cores >= 1
    assert not slept.granted
    watched = clocks.look(0.01)
    assert watched.moved_s == pytest.approx(0.0, abs=0.5)
    assert watched.synchronised in (True, False, None)


def test_a_missing_folder_is_judged_by_its_parent_and_not_created(tmp_path):
    entry = LogEntry(name="a", bytes=3_000_000, modified=datetime.now(UTC), duration_s=30.0, finished=True)
    unfinished = entry.model_copy(update={"duration_s": None, "bytes": 10**9})
    facts = disk.look(Recorder(directory=tmp_path / "deep" / "logs"), (entry, unfinished))
    assert (facts.writable, facts.log_bytes_s) == (True, 100e3)
    assert facts.bytes_s is not None
    assert facts.bytes_s > 0.0
    assert list(tmp_path.iterdir()) == []
    assert disk.look(Recorder(directory=tmp_path), measured=False).bytes_s is None


def test_a_folder_that_is_a_file_cannot_be_written(tmp_path):
    (tmp_path / "logs").write_text("")
    assert not disk.look(Recorder(directory=tmp_path / "logs")).writable


def test_a_folder_that_the_system_refuses_to_look_at_has_no_logs(tmp_path):
    refused = tmp_path / ("x" * 300) / "logs"
    assert listing(refused) == ()
    assert disk.look(Recorder(directory=refused)).folder == refused
