"""An interrupted recording is readable up to its end."""

from dataclasses import replace

import pytest
from mcap.writer import Writer

from softarm.recordings import finishing
from softarm.recordings.channels import RAIL
from softarm.recordings.log_file import LogFile
from softarm.recordings.mcap_file import LogError, messages
from softarm.schemas import log


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


def test_records_without_their_definition_are_omitted(killed, readings):
    """A message of a channel, a channel of a schema, that a damaged file does not hold."""
    with killed.open("wb") as file:
        writer = Writer(file, use_chunking=False)
        writer.start(profile="", library="")
        rail = writer.register_channel(RAIL.topic, "json", writer.register_schema("rail", "jsonschema", b"{}"))
        lost = writer.register_channel("lost", "json", 99)
        bare = writer.register_channel("bare", "json", 0)
        for channel in (rail, bare + 7, lost, bare):
            writer.add_message(channel, 1, RAIL.encode(readings[0]), 1)
    assert [topic for topic, _ in messages(killed)] == [RAIL.topic, "bare"]
    assert LogFile.open(killed).records == 2
    assert finishing.recover(killed).records == 2


@pytest.mark.parametrize("metadata", [{}, {log.CONFIGURATION: {}}, {log.CONFIGURATION: {"json": "{"}}])
def test_a_log_without_a_configuration_that_can_be_read_says_so(killed, metadata):
    opened = replace(LogFile.open(killed), metadata=metadata)
    with pytest.raises(LogError, match=r"killed\.mcap: holds no configuration that can be read .*; name another log"):
        assert opened.config


@pytest.mark.parametrize("read", [lambda path: list(messages(path)), LogFile.open])
def test_a_missing_file_or_another_format_is_reported(tmp_path, read):
    with pytest.raises(LogError, match=r"nothing\.mcap: cannot be read \(No such file"):
        read(tmp_path / "nothing.mcap")
    (tmp_path / "notes.mcap").write_text("hello, this is not a log")
    with pytest.raises(LogError, match="not a log; a log is an MCAP file"):
        read(tmp_path / "notes.mcap")
