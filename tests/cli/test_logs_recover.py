"""`softarm logs recover` mends what was cut off, and says of every log what became of it."""

import pytest
from click.testing import CliRunner

from softarm.cli.main import main
from softarm.recordings import finishing, mcap_file
from softarm.recordings.channels import RAIL
from softarm.recordings.live import LiveFile, LogMessage
from softarm.schemas.messages import RailReading


@pytest.fixture
def cut_off(tmp_path):
    """As a killed daemon leaves a log: no index, the last record half written."""
    path = tmp_path / "logs" / "softarm-20260101T000000Z.mcap"
    path.parent.mkdir()
    with path.open("wb") as file:
        live = LiveFile(file, [RAIL])
        for n in range(100):
            live.add(LogMessage(RAIL.topic, n, n, RAIL.encode(RailReading(n, n / 7, 0.0, True))))
        live.flush()
    path.write_bytes(path.read_bytes()[:-5])
    return path


def recover(*paths):
    return CliRunner().invoke(main, ["logs", "recover", *map(str, paths)])


def test_a_log_that_was_cut_off_is_mended_and_a_second_time_left_alone(cut_off):
    result = recover(cut_off)
    assert result.exit_code == 0
    assert result.stdout.startswith(f"{cut_off}: mended; 99 whole records over 0.00 s (0.0 MB, now ")
    assert mcap_file.is_finished(cut_off)
    assert len(list(mcap_file.messages(cut_off))) == 99
    assert recover(cut_off).stdout == f"{cut_off}: is finished, nothing to mend\n"


def test_a_folder_is_gone_through_and_one_that_cannot_be_mended_ends_with_1(cut_off):
    rubbish, empty = cut_off.with_name("a.mcap"), cut_off.with_name("b.mcap")
    rubbish.write_bytes(b"no log at all, but long enough")
    empty.touch()
    result = recover(cut_off.parent)
    assert result.exit_code == 1
    assert f"{cut_off}: mended" in result.stdout
    assert result.stderr.splitlines() == [
        f"{rubbish}: not a log; a log is an MCAP file, as the recorder writes it",
        f"{empty}: holds no whole record, left as it is; delete it",
    ]
    assert rubbish.read_bytes().startswith(b"no log")


def test_a_log_that_a_daemon_writes_is_left_alone(cut_off):
    before = cut_off.read_bytes()
    with cut_off.open("rb") as writer:
        finishing.hold(writer.fileno())
        result = recover(cut_off)
    assert (result.exit_code, cut_off.read_bytes()) == (0, before)
    assert result.stdout == f"{cut_off}: is being written by a running daemon, left alone\n"


def test_a_folder_without_logs_and_no_path_at_all_are_told(tmp_path):
    result = recover(tmp_path)
    assert result.exit_code == 1
    assert result.stderr == f"{tmp_path}: no logs there; name the recorder's directory or a log\n"
    assert recover().exit_code == 2
