"""Recovery of an unfinished log."""

import pytest
from mcap.reader import make_reader

from softarm.recordings import finishing, mcap_file
from softarm.recordings.channels import RAIL


def test_recover_writes_an_indexed_file_of_all_complete_records(killed, readings):
    killed.write_bytes(killed.read_bytes()[:-3])
    assert not mcap_file.is_finished(killed)
    log = finishing.recover(killed)
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
    finishing.recover(killed)
    assert [path.name for path in killed.parent.iterdir()] == [killed.name]


def test_recover_that_is_interrupted_leaves_the_old_file(killed):
    before = killed.read_bytes()

    def interrupt() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        finishing.recover(killed, interrupt)
    assert killed.read_bytes() == before
    assert [path.name for path in killed.parent.iterdir()] == ["killed.mcap"]


def test_an_open_or_empty_log_is_unchanged(killed, tmp_path):
    before = killed.read_bytes()
    with killed.open("rb") as writer:
        finishing.hold(writer.fileno())
        assert not finishing.recover(killed).finished
    assert killed.read_bytes() == before
    empty = tmp_path / "empty.mcap"
    empty.touch()
    finishing.finish(empty)
    assert empty.read_bytes() == b""
