"""A recording is read up to where it breaks off, by whoever reads it."""

import pytest

from softarm.recordings.channels import RAIL
from softarm.recordings.log_file import LogFile
from softarm.recordings.mcap_file import LogError, messages


def test_every_cut_gives_a_prefix(killed, readings):
    data, counts = killed.read_bytes(), []
    for length in [*range(0, len(data), 37), len(data)]:
        killed.write_bytes(data[:length])
        read = [RAIL.decode(message) for _, message in messages(killed)]
        assert repr(read) == repr(readings[: len(read)])
        assert LogFile.open(killed).records == len(read)
        counts.append(len(read))
    assert counts == sorted(counts)
    assert (counts[0], counts[-1]) == (0, len(readings))


@pytest.mark.parametrize("read", [lambda path: list(messages(path)), LogFile.open])
def test_what_is_not_there_or_no_log_is_told(tmp_path, read):
    with pytest.raises(LogError, match=r"nothing\.mcap: cannot be read \(No such file"):
        read(tmp_path / "nothing.mcap")
    (tmp_path / "notes.mcap").write_text("hello, this is not a log")
    with pytest.raises(LogError, match="not a log; a log is an MCAP file"):
        read(tmp_path / "notes.mcap")
