"""Whoever has something open is found by it."""

import os
from pathlib import Path

from softarm.common.holders import holders


def test_a_process_is_found_by_a_file_that_it_has_open(tmp_path):
    place = tmp_path / "held"
    with place.open("w"):
        assert Path("/proc", str(os.getpid())) in list(holders({str(place)}))
    assert not list(holders({str(place)}))


def test_nothing_is_held_by_nobody():
    assert not list(holders(()))
