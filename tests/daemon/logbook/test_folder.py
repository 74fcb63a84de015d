"""Old logs of the folder: deletion of the oldest, and finishing of interrupted ones."""

import os

import pytest

from softarm.daemon.logbook.folder import delete_oldest, finish_left
from softarm.recordings import log_file
from softarm.schemas.config import Recorder

DAY_S = 86_400.0


@pytest.fixture
def directory(tmp_path):
    """Return a folder with five daily logs of 1 MB; the newest is being written."""
    for day in range(1, 6):
        path = tmp_path / f"softarm-2026010{day}T000000Z.mcap"
        path.write_bytes(b"0" * 1_000_000)
        os.utime(path, (day * DAY_S, day * DAY_S))
    return tmp_path


def days(directory, **keep) -> list[int]:
    """Return the days of the remaining logs."""
    own = directory / "softarm-20260105T000000Z.mcap"
    delete_oldest(directory, own, Recorder(**keep), now_s=5 * DAY_S)
    return [int(path.name[14:16]) for path in sorted(directory.glob("softarm-2026*.mcap"))]


@pytest.mark.parametrize(
    ("keep", "left"),
    [
        ({"keep_mb": 20_000, "keep_days": 365}, [1, 2, 3, 4, 5]),
        ({"keep_mb": 3}, [3, 4, 5]),
        ({"keep_days": 1.5}, [4, 5]),
    ],
)
def test_the_oldest_logs_beyond_size_and_age_are_deleted(directory, keep, left):
    assert days(directory, **keep) == left


def test_no_log_is_deleted_by_default(directory):
    with (directory / "softarm-20260101T000000Z.mcap").open("r+b") as file:
        file.truncate(10**12)  # a sparse terabyte
    assert days(directory) == [1, 2, 3, 4, 5]


def test_the_log_being_written_stays_at_any_size(directory):
    (directory / "softarm-20260105T000000Z.mcap").write_bytes(b"0" * 5_000_000)
    assert days(directory, keep_mb=2) == [5]


def test_the_log_of_another_daemon_stays_while_it_is_written(directory):
    with (directory / "softarm-20260101T000000Z.mcap").open("rb") as file:
        log_file.hold(file.fileno())
        assert days(directory, keep_mb=2) == [1, 5]


def test_a_file_that_a_person_has_named_is_never_touched(directory):
    (directory / "softarm-20260101T000000Z.mcap").rename(directory / "best-flight.mcap")
    (directory / "softarm-notes.mcap").touch()
    assert days(directory, keep_mb=2, keep_days=0.5) == [5]
    assert (directory / "best-flight.mcap").exists()
    assert (directory / "softarm-notes.mcap").exists()


def test_a_pipe_among_the_logs_does_not_hold_up_the_recorder(tmp_path):
    os.mkfifo(tmp_path / "pipe.mcap")
    finish_left(tmp_path, tmp_path / "own.mcap", lambda: None)
    assert (tmp_path / "pipe.mcap").is_fifo()
