"""A log as a file: records up to a break, its end, finishing, recovery, and the list of a folder."""

import shutil
from dataclasses import replace

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from softarm.recordings import log_file, mcap_file
from softarm.recordings.live import RAIL
from softarm.recordings.log_file import LogFile, listing
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
    assert log_file.recover(killed).records == 2


def test_a_finished_log_that_is_damaged_within_is_refused(killed):
    """Its messages after the damage are lost, and its end says that it is whole."""
    log_file.finish(killed)
    data = bytearray(killed.read_bytes())
    data[data.index(bytes.fromhex("28b52ffd")) + 40] ^= 0xFF  # within the compressed messages
    killed.write_bytes(data)
    with pytest.raises(LogError, match=r"killed\.mcap: is damaged after 0 messages; restore a copy"):
        LogFile.open(killed)


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


def test_recover_writes_an_indexed_file_of_all_complete_records(killed, readings):
    killed.write_bytes(killed.read_bytes()[:-3])
    assert not mcap_file.is_finished(killed)
    log = log_file.recover(killed)
    assert log.finished
    assert mcap_file.is_finished(killed)
    assert log.metadata == {"machine": {"name": "a test's"}}
    assert repr([RAIL.decode(data) for _, data in mcap_file.messages(killed)]) == repr(readings[:-1])
    with killed.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary.chunk_indexes[0].compression == "zstd"
    assert [path.name for path in killed.parent.iterdir()] == ["killed.mcap"]


def test_recover_deletes_the_draft_of_a_killed_recovery(killed):
    (killed.parent / f".{killed.name}.draft").write_bytes(b"half")
    log_file.recover(killed)
    assert [path.name for path in killed.parent.iterdir()] == [killed.name]


def test_recover_that_is_interrupted_leaves_the_old_file(killed):
    before = killed.read_bytes()

    def interrupt() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        log_file.recover(killed, interrupt)
    assert killed.read_bytes() == before
    assert [path.name for path in killed.parent.iterdir()] == ["killed.mcap"]


def test_an_open_or_empty_log_is_unchanged(killed, tmp_path):
    before = killed.read_bytes()
    with killed.open("rb") as writer:
        log_file.hold(writer.fileno())
        assert not log_file.recover(killed).finished
    assert killed.read_bytes() == before
    empty = tmp_path / "empty.mcap"
    empty.touch()
    log_file.finish(empty)
    assert empty.read_bytes() == b""


def test_the_listing_distinguishes_finished_and_unfinished_logs(killed, readings):
    done = killed.with_name("done.mcap")
    shutil.copy(killed, done)
    log_file.finish(done)
    killed.with_name("empty.mcap").touch()
    killed.with_name("damaged.mcap").write_bytes(done.read_bytes()[:9] + bytes(50) + done.read_bytes()[-20:])
    entries = {entry.name: entry for entry in listing(killed.parent)}
    assert set(entries) == {"done.mcap", "killed.mcap", "empty.mcap", "damaged.mcap"}
    assert [name for name, entry in entries.items() if entry.finished] == ["done.mcap"]
    assert entries["done.mcap"].duration_s == pytest.approx((len(readings) - 1) * 0.1)
    assert entries["done.mcap"].bytes == done.stat().st_size
    assert entries["killed.mcap"].duration_s is None
    assert listing(killed.parent / "nowhere") == ()
