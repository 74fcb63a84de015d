"""Search for processes by their open files."""

import os
from pathlib import Path

from softarm.daemon.access.holders import holders


def test_a_process_is_found_by_a_file_that_it_has_open(tmp_path):
    place = tmp_path / "held"
    with place.open("w"):
        assert Path("/proc", str(os.getpid())) in list(holders({str(place)}))
    assert not list(holders({str(place)}))
