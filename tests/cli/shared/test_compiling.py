"""Tests of the message before the first compile of the simulator."""

import subprocess
import sys

import pytest

PROGRAM = """
import logging, numba, sys, time
from softarm.cli.groups import compilation_announced
from softarm.common.processes import work_clock
if sys.argv[1] == "daemon":
    logging.basicConfig(format="by the daemon's log: %(message)s")
with compilation_announced():
    from softarm.simulator import compiled
    before = time.monotonic() - work_clock()
    compiled._inform_once(compiled.COMPILING)
    compiled._inform_once(compiled.COMPILING)
    numba.njit(lambda x: x + 1)(1.0)
    print(time.monotonic() - work_clock() - before > 0.001)
"""


@pytest.mark.parametrize(("program", "start"), [("a verb", ""), ("daemon", "by the daemon's log: ")])
def test_compiling_is_announced_once_and_does_not_count_for_the_remaining_time_of_a_verb(program, start):
    command = [sys.executable, "-c", PROGRAM, program]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    assert done.stderr == f"{start}compiling the simulator for this machine: once, for about half a minute ...\n"
    assert program == "daemon" or done.stdout == "True\n"
