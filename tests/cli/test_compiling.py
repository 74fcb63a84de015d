"""The first compile of the simulator is no silence."""

import logging
import subprocess
import sys

from softarm.cli.compiling import LOGGER, told_of_compiling

PROGRAM = """
import logging, sys
from softarm.cli.compiling import told_of_compiling
if sys.argv[1] == "daemon":
    logging.basicConfig(format="by the daemon's log: %(message)s")
with told_of_compiling():
    from softarm.simulator import compiled
    compiled._tell(compiled.COMPILING)
    compiled._tell(compiled.COMPILING)
"""


def said(who):
    return subprocess.run([sys.executable, "-c", PROGRAM, who], check=True, capture_output=True, text=True).stderr


def test_it_is_said_once_by_whoever_prints():
    line = "compiling the simulator for this machine: once, for about half a minute ...\n"
    assert said("a verb") == line
    assert said("daemon") == f"by the daemon's log: {line}"


def test_nothing_is_left_behind():
    logger = logging.getLogger(LOGGER)
    before = (logger.level, list(logger.handlers))
    with told_of_compiling():
        assert logger.isEnabledFor(logging.INFO)
    assert (logger.level, logger.handlers) == before
