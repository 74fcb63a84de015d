"""Tests of the message before the first compile of the simulator."""

import io
import logging
import time

import numba
import pytest

from softarm.cli.groups import compilation_announced
from softarm.common.processes import work_clock
from softarm.simulator import compiled


@pytest.mark.parametrize("daemon", [False, True], ids=["a verb", "the daemon"])
def test_compiling_is_announced_once_and_does_not_count_for_the_remaining_time_of_a_verb(monkeypatch, capsys, daemon):
    log = io.StringIO()
    monkeypatch.setattr(logging.getLogger(), "handlers", [logging.StreamHandler(log)] if daemon else [])
    compiled._inform_once.cache_clear()
    with compilation_announced():
        before_s = time.monotonic() - work_clock()
        compiled._inform_once(compiled.COMPILING)
        compiled._inform_once(compiled.COMPILING)
        numba.njit(lambda x: x + 1)(1.0)
        assert daemon or time.monotonic() - work_clock() - before_s > 0.001
    message = "compiling the simulator for this machine: once, for about half a minute ...\n"
    assert (capsys.readouterr().err, log.getvalue()) == (("", message) if daemon else (message, ""))
