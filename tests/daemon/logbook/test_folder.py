"""The recorder deletes the oldest of its own logs, and nothing else."""

import os

import pytest

from softarm.daemon.logbook.folder import delete_oldest
from softarm.recordings import finishing
from softarm.schemas.config import Recorder

DAY_S = 86_400.0


@pytest.fixture
def directory(tmp_path):
    """Five logs of 1 MB, a day apart; the newest, of day 5, is being written."""
    for day in range(1, 6):
        path = tmp_path / f"softarm-2026010{day}T000000Z.mcap"
        path.write_bytes(b"0" * 1_000_000)
        os.utime(path, (day * DAY_S, day * DAY_S))
    return tmp_path


def days(directory, **keep) -> list[int]:
    """The days whose logs are left."""
    own = directory / "softarm-20260105T000000Z.mcap"
    delete_oldest(directory, own, Recorder(**keep), now_s=5 * DAY_S)
    return [int(path.name[14:16]) for path in sorted(directory.glob("softarm-2026*.mcap"))]


def test_within_size_and_age_all_are_kept(directory):
    assert days(directory, keep_mb=20_000, keep_days=365) == [1, 2, 3, 4, 5]


def test_nobody_s_recordings_are_deleted_unasked(directory):
    with (directory / "softarm-20260101T000000Z.mcap").open("r+b") as file:
        file.truncate(10**12)  # a sparse terabyte
    assert days(directory) == [1, 2, 3, 4, 5]


def test_the_oldest_go_until_the_rest_is_small_enough(directory):
    assert days(directory, keep_mb=3) == [3, 4, 5]


def test_what_is_too_old_goes(directory):
    assert days(directory, keep_days=1.5) == [4, 5]


def test_the_log_being_written_stays_whatever_its_size(directory):
    (directory / "softarm-20260105T000000Z.mcap").write_bytes(b"0" * 5_000_000)
    assert days(directory, keep_mb=2) == [5]


def test_the_log_of_another_daemon_stays_while_it_is_written(directory):
    with (directory / "softarm-20260101T000000Z.mcap").open("rb") as file:
        finishing.hold(file.fileno())
        assert days(directory, keep_mb=2) == [1, 5]


def test_a_file_that_a_person_has_named_is_never_touched(directory):
    (directory / "softarm-20260101T000000Z.mcap").rename(directory / "best-flight.mcap")
    (directory / "softarm-notes.mcap").touch()
    assert days(directory, keep_mb=2, keep_days=0.5) == [5]
    assert (directory / "best-flight.mcap").exists()
    assert (directory / "softarm-notes.mcap").exists()
