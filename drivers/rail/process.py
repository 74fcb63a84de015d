"""The rail's process: `python -m softarm.drivers.rail.process`, started by `driver.py`, with the pair as its input.

It waits until it is told to begin: a second one is kept ready, so that the end of the first costs no start of a
program. It outlives the daemon by as long as it takes to stop the drive: no signal that a terminal or a service manager
sends ends it, only the end of the pair does. Imports next to nothing, so that it is there at once and nobody's hostage.
"""

import contextlib
import os
import signal
import socket
import sys

from softarm.drivers.rail import pair
from softarm.drivers.rail.master import Master
from softarm.drivers.rail.settings import Settings

MCL_CURRENT = 1


def arguments(settings: Settings, priority: int) -> list[str]:
    """For the command line: what `main` reads."""
    host, port, *numbers = settings
    return [str(priority), host, str(port), *(str(float(number)) for number in numbers)]


def main(words: list[str]) -> None:
    """Lead the drive until the daemon hangs up."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    priority, host, port, *numbers = words
    _outrank(int(priority))
    _stay_in_memory()
    *sizes, flips, asks = map(float, numbers)
    settings = Settings._make((host, int(port), *sizes, bool(flips), bool(asks)))
    with socket.socket(fileno=os.dup(sys.stdin.fileno())) as daemon:
        sys.stdin.close()
        packet = daemon.recv(pair.PACKET_MAX)
        if packet:  # else the daemon has ended, and nothing was begun
            Master(settings, daemon, pair.decode_begin(packet)).run()


def _outrank(priority: int) -> None:
    """SCHED_FIFO, where it is granted; 0: leave the scheduling as it is."""
    if priority:
        with contextlib.suppress(PermissionError):  # the daemon has said so of itself
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))


def _stay_in_memory() -> None:
    """No page of this process is fetched from a disk while a cart is moving; where that is granted."""
    import ctypes

    ctypes.CDLL(None).mlockall(MCL_CURRENT)


if __name__ == "__main__":
    main(sys.argv[1:])
