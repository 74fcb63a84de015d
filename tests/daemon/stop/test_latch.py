"""Latch on disk: no kill and no interrupted write loses a stop."""

import os
import re
import threading
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta

import httpx
import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st

from softarm.daemon.config.configuration import latch_path
from softarm.daemon.stop import latch
from softarm.daemon.stop.latch import SIZE, LatchError, LatchKeeper, Stop, decoded, encoded
from softarm.schemas.config import Config
from tests.processes import free_port, running, said, until

WHY = "the drive reports a fault (E12): clear the cause at the drive, then run `softarm acknowledge`"


@pytest.fixture
def path(tmp_path):
    return tmp_path / "robot" / "stop.json"


@contextmanager
def keeping(path, **clocks):
    made = LatchKeeper(path, **clocks)
    made.start()
    try:
        yield made
    finally:
        made.stop()


def killed(path):
    """Return the latch as a new daemon finds it after a kill: the unlocked file."""
    return decoded(path.read_bytes()).reason


def test_a_robot_without_a_stop_begins_clear_and_leaves_no_file(path):
    with keeping(path) as keeper:
        assert (keeper.left, keeper.problem, killed(path)) == (None, None, None)
    assert not path.exists()


def test_a_stop_is_written_in_place_without_further_calls(path):
    with keeping(path) as keeper:
        before = path.stat()
        keeper.note(WHY)
        until(lambda: killed(path) == WHY)
        after = path.stat()
    assert before.st_size == after.st_size == SIZE
    assert (before.st_ino, before.st_blocks) == (after.st_ino, after.st_blocks)
    with keeping(path) as keeper:
        assert keeper.left == WHY
        keeper.note(None)
        until(lambda: killed(path) is None)
    with keeping(path) as keeper:
        assert keeper.left is None


def test_closing_writes_the_last_stop(path):
    with keeping(path) as keeper:
        for number in range(20):
            keeper.note(f"stop {number}")
    assert killed(path) == "stop 19"


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "0 bytes, not a record"),
        (b"\0" * SIZE, ""),
        (encoded(Stop())[:-1], "4095 bytes"),
        (encoded(Stop()) + b" ", "4097 bytes"),
        (b"[" * SIZE, ""),
        (b'{"version": 2, "free": true}'.ljust(SIZE), "version 2, this software reads 1"),
        (b'{"version": 1, "stopped": "no time"}'.ljust(SIZE), "not a record of a stop"),
    ],
)
def test_a_file_that_cannot_be_read_counts_as_a_stop(path, content, why):
    path.parent.mkdir()
    path.write_bytes(content)
    with keeping(path) as keeper:
        assert f"the latch is unreadable ({path}: {why}" in keeper.left
        assert keeper.left_at is None
        keeper.note(None)
        until(lambda: path.read_bytes() == encoded(Stop()))


stops = st.just(Stop()) | st.builds(Stop, st.text(max_size=latch.REASON_MAX), st.none() | st.floats(1, 1e11))


@settings(max_examples=100, deadline=None)
@given(stops, stops, st.integers(0, SIZE))
@example(Stop("abcd", 1.0), Stop(), len('{"version": 1, "stopped": null'))
@example(Stop("ab", 1.0), Stop(), len('{"version": 1, "stopped": null'))
def test_a_write_cut_short_leaves_the_old_the_new_or_a_stop(old, new, whole):
    torn = encoded(new)[:whole] + encoded(old)[whole:]
    assert len(torn) == SIZE
    try:
        found = decoded(torn).reason
    except ValueError:
        return  # a stop
    assert found is not None or Stop() in (old, new)
    if found is None and new != Stop():
        assert torn == encoded(Stop())  # nothing of the new one is on the disk yet
    if found is None and old != Stop():
        assert torn == encoded(Stop())  # nothing of the old one is left


@given(st.text())
def test_a_reason_of_any_length_and_alphabet_fits(reason):
    assert decoded(encoded(Stop(reason, 1.8e9))) == Stop(reason[: latch.REASON_MAX], 1.8e9)


@pytest.mark.parametrize("time", ["1", "-1.0", "1e999", "NaN", "253402300800.0", '"now"', "null", "[1.0]"])
def test_an_invalid_time_leaves_the_stop_valid(time):
    content = f'{{"version": 1, "stopped": "why", "time": {time}}}'.encode().ljust(SIZE)
    assert decoded(content) == Stop("why", None)


def test_a_left_stop_keeps_its_time_until_the_next_one(path):
    wall_s = [1_800_000_000.25]

    def again():
        return keeping(path, wall=lambda: wall_s[0])

    with again() as keeper:
        assert keeper.left_at is None
        keeper.note(WHY)
    wall_s[0] += 1000
    with again() as keeper:
        keeper.note(WHY)  # as every tick says that follows
    with again() as keeper:
        assert keeper.left_at == datetime(2027, 1, 15, 8, 0, 0, 250_000, UTC)
        keeper.note(None)
        keeper.note(WHY)
    with again() as keeper:
        assert keeper.left_at == datetime(2027, 1, 15, 8, 16, 40, 250_000, UTC)


def test_a_failing_disk_is_a_problem_until_the_write_succeeds(path, monkeypatch):
    monkeypatch.setattr(latch, "RETRY_S", 0.01)
    write = os.pwrite
    broken = threading.Event()
    broken.set()

    def failing(*arguments):
        if broken.is_set():
            raise OSError(5, "Input/output error")
        return write(*arguments)

    monkeypatch.setattr(os, "pwrite", failing)
    with keeping(path) as keeper:
        keeper.note(WHY)
        until(lambda: keeper.problem is not None)
        assert keeper.problem == f"{path}: cannot be written (Input/output error)"
        broken.clear()
        until(lambda: keeper.problem is None)
        assert killed(path) == WHY
        broken.set()
        keeper.note(None)
        until(lambda: keeper.problem is not None)
        keeper.note(WHY)  # as the file has it, for all that is known
        broken.clear()
        until(lambda: keeper.problem is None)


def test_a_disk_that_hangs_is_a_problem_within_a_second(path, monkeypatch):
    now_s, release = [0.0], threading.Event()
    monkeypatch.setattr(os, "fdatasync", lambda _: release.wait(10.0))
    with keeping(path, clock=lambda: now_s[0]) as keeper:
        keeper.note(WHY)
        now_s[0] = 0.9
        assert keeper.problem is None
        now_s[0] = 1.2
        assert keeper.problem == f"{path}: not written for 1 s"
        release.set()


def test_a_second_daemon_of_the_same_robot_is_refused(path):
    with keeping(path) as first:
        with pytest.raises(LatchError, match="another daemon controls this robot"):
            LatchKeeper(path).start()
        first.note(WHY)
        until(lambda: killed(path) == WHY)


def test_a_daemon_that_starts_at_the_same_moment_is_refused(path, monkeypatch):
    write, other = latch.files.write_bytes, LatchKeeper(path)

    def write_after_the_other(*arguments):
        monkeypatch.setattr(latch.files, "write_bytes", write)
        other.start()
        write(*arguments)

    monkeypatch.setattr(latch.files, "write_bytes", write_after_the_other)
    with pytest.raises(LatchError, match="another daemon controls this robot"):
        LatchKeeper(path).start()
    assert [each.name for each in path.parent.iterdir()] == [path.name]
    other.stop()


def test_an_unwritable_directory_is_reported(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(
        LatchError,
        match=r"stop\.json: the latch of the emergency stop cannot be kept there .* make file and folder writable",
    ):
        LatchKeeper(tmp_path / "file" / "stop.json").start()


def test_the_file_is_the_robots_whatever_else_is_configured(tmp_path):
    one = Config(drivers={"rail": {"host": "fe80::1", "port": 502}}, api={"port": 1}, recorder={"directory": tmp_path})
    assert latch_path(one, {}) == tmp_path / "stop-fe80__1-502.json"
    service = latch_path(one, {"STATE_DIRECTORY": "/var/lib/softarm:/var/lib/other"})
    assert str(service) == "/var/lib/softarm/stop-fe80__1-502.json"


@contextmanager
def daemon(folder):
    """Run a daemon of a missing robot and kill it; yield its client, its stop address and its first line."""
    settings = {
        "api": {"port": 0},
        "drivers": {
            "mocap": {"endpoint": f"tcp/127.0.0.1:{free_port()}"},
            "regulator": {"port": str(folder / "none")},
            "rail": {"host": "127.0.0.1", "port": 1},
        },
        "control": {"policy": "hold"},
        "recorder": {"directory": str(folder / "logs")},
    }
    (folder / "arm.yaml").write_text(yaml.safe_dump(settings))
    with running("run", "--config", folder / "arm.yaml") as process:
        first = said(process, "(.*serving .*)")
        stop_url = said(process, r"POST (http://\S+)")
        with httpx.Client(base_url=re.search(r"serving (\S+)", first)[1], timeout=10.0) as client:
            until(lambda: client.get("/api/status").status_code == 200)
            yield client, stop_url, first


# Over 3 s: two daemons, one after the other.
@pytest.mark.slow
def test_a_daemon_that_is_killed_begins_stopped_until_that_is_acknowledged(tmp_path):
    file = tmp_path / "logs" / "stop-127.0.0.1-1.json"
    with daemon(tmp_path) as (client, stop_url, _):
        assert client.get("/api/status").json()["estop"] == "clear"
        assert httpx.post(stop_url).json()["stopped"] is True
        stopped_at = datetime.fromisoformat(client.get("/api/status").json()["last_stop_at"])
        until(lambda: killed(file) is not None)
    with daemon(tmp_path) as (client, _, first):
        status = client.get("/api/status").json()
        assert (status["mode"], status["estop"]) == ("stopped", "latched")
        assert status["last_stop"].startswith("an emergency stop was requested")
        assert abs(datetime.fromisoformat(status["last_stop_at"]) - stopped_at) < timedelta(seconds=1)
        assert "stopped since its last run (an emergency stop was requested" in first
        assert client.post("/api/acknowledge").status_code == 200
        until(lambda: killed(file) is None)
