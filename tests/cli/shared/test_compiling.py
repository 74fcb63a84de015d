"""Tests of the message before the first compile of the simulator."""

import subprocess
import sys

PROGRAM = """
import logging, sys
from softarm.cli.groups import compilation_announced
if sys.argv[1] == "daemon":
    logging.basicConfig(format="by the daemon's log: %(message)s")
with compilation_announced():
    from softarm.simulator import compiled
    compiled._inform_once(compiled.COMPILING)
    compiled._inform_once(compiled.COMPILING)
"""


def stderr(program):
    return subprocess.run([sys.executable, "-c", PROGRAM, program], check=True, capture_output=True, text=True).stderr


def test_compiling_is_announced_once():
    line = "compiling the simulator for this machine: once, for about half a minute ...\n"
    assert stderr("a verb") == line
    assert stderr("daemon") == f"by the daemon's log: {line}"


COMPILED = """
import numba, time
from softarm.cli.groups import compilation_announced
from softarm.common.processes import work_clock
with compilation_announced():
    from softarm.simulator import compiled
    before = time.monotonic() - work_clock()
    compiled._inform_once(compiled.COMPILING)
    numba.njit(lambda x: x + 1)(1.0)
    print(time.monotonic() - work_clock() - before > 0.001)
"""


def test_compiling_does_not_count_for_the_remaining_time():
    done = subprocess.run([sys.executable, "-c", COMPILED], check=True, capture_output=True, text=True)
    assert done.stdout == "True\n"
