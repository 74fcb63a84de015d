"""List of the logs in a folder."""

import shutil

import pytest

from softarm.recordings import finishing
from softarm.recordings.listing import listing


def test_the_listing_distinguishes_finished_and_unfinished_logs(killed, readings):
    done = killed.with_name("done.mcap")
    shutil.copy(killed, done)
    finishing.finish(done)
    killed.with_name("empty.mcap").touch()
    killed.with_name("damaged.mcap").write_bytes(done.read_bytes()[:9] + bytes(50) + done.read_bytes()[-20:])
    entries = {entry.name: entry for entry in listing(killed.parent)}
    assert set(entries) == {"done.mcap", "killed.mcap", "empty.mcap", "damaged.mcap"}
    assert [name for name, entry in entries.items() if entry.finished] == ["done.mcap"]
    assert entries["done.mcap"].duration_s == pytest.approx((len(readings) - 1) * 0.1)
    assert entries["done.mcap"].bytes == done.stat().st_size
    assert entries["killed.mcap"].duration_s is None
    assert listing(killed.parent / "nowhere") == ()
