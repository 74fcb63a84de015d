"""Tests of `softarm logs recover`."""

import pytest

from softarm.recordings import finishing, mcap_file
from softarm.recordings.channels import RAIL
from softarm.schemas.messages import RailReading
from tests.cli.invoke import invoke
from tests.recordings.conftest import write


@pytest.fixture
def cut_off(tmp_path):
    """Return a log as a killed daemon leaves it: no index, the last record incomplete."""
    path = tmp_path / "logs" / "softarm-20260101T000000Z.mcap"
    path.parent.mkdir()
    write(path, ((n, RAIL.encode(RailReading(n, n / 7, 0.0, True))) for n in range(100)))
    path.write_bytes(path.read_bytes()[:-5])
    return path


def recover(*paths):
    return invoke("logs", "recover", *paths)


def test_a_truncated_log_is_repaired_once(cut_off):
    result = recover(cut_off)
    assert result.exit_code == 0
    assert result.stdout.startswith(f"{cut_off}: repaired; 99 complete records over 0.00 s (0.0 MB, now ")
    assert mcap_file.is_finished(cut_off)
    assert len(list(mcap_file.messages(cut_off))) == 99
    assert recover(cut_off).stdout == f"{cut_off}: is finished, nothing to repair\n"


def test_every_log_of_a_folder_is_repaired_and_a_failure_exits_with_1(cut_off):
    rubbish, empty = cut_off.with_name("a.mcap"), cut_off.with_name("b.mcap")
    rubbish.write_bytes(b"no log at all, but long enough")
    empty.touch()
    result = recover(cut_off.parent)
    assert result.exit_code == 1
    assert f"{cut_off}: repaired" in result.stdout
    assert result.stderr.splitlines() == [
        f"{rubbish}: not a log; a log is an MCAP file, as the recorder writes it",
        f"{empty}: has no complete record and was not changed; delete it",
    ]
    assert rubbish.read_bytes().startswith(b"no log")


def test_a_log_in_use_is_not_changed(cut_off):
    before = cut_off.read_bytes()
    with cut_off.open("rb") as writer:
        finishing.hold(writer.fileno())
        result = recover(cut_off)
    assert (result.exit_code, cut_off.read_bytes()) == (0, before)
    assert result.stdout == f"{cut_off}: is being written by a running daemon, left alone\n"
