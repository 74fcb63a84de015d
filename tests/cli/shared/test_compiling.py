"""Tests of the message before the first compile of the simulator."""

import logging
import subprocess
import sys

from softarm.cli.shared.compiling import LOGGER, compilation_announced

PROGRAM = """
import logging, sys
from softarm.cli.shared.compiling import compilation_announced
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


def test_the_logger_is_restored():
    logger = logging.getLogger(LOGGER)
    before = (logger.level, list(logger.handlers))
    with compilation_announced():
        assert logger.isEnabledFor(logging.INFO)
    assert (logger.level, logger.handlers) == before
