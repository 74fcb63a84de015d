"""The rail's process: `python -m softarm.drivers.rail.process`, started by `driver.py` with the socket pair as input.

It waits for a begin message: the daemon keeps a second process ready, so that a replacement needs no start-up time.
It outlives the daemon until the drive is stopped: it ignores signals, and only the end of the pair ends it. Its exit
code is 0 if the drive was disabled or could not be reached. It imports as little as possible, to start fast and to
depend on nothing that could fail.
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
# systemd sends SIGTERM, and SIGABRT of its watchdog, to every process of the service.
IGNORED = "SIGINT", "SIGTERM", "SIGHUP", "SIGABRT", "SIGQUIT", "SIGALRM", "SIGUSR1", "SIGUSR2"


def arguments(settings: Settings, priority: int) -> list[str]:
    """Return the command line that `main` parses."""
    host, port, *numbers = settings
    return [str(priority), host, str(port), *(str(float(number)) for number in numbers)]


def main(words: list[str]) -> None:
    """Control the drive until the daemon closes the pair."""
    for name in IGNORED:
        signal.signal(signal.Signals[name], signal.SIG_IGN)
    priority, host, port, *numbers = words
    _set_realtime_priority(int(priority))
    _lock_memory()
    *sizes, is_reversed, asks_homed = map(float, numbers)
    settings = Settings._make((host, int(port), *sizes, bool(is_reversed), bool(asks_homed)))
    with socket.socket(fileno=os.dup(sys.stdin.fileno())) as daemon:
        sys.stdin.close()
        # An empty packet means that the daemon has ended before this process began.
        packet = daemon.recv(pair.PACKET_MAX)
        if packet:
            Master(settings, daemon, pair.decode_begin(packet)).run()


def _set_realtime_priority(priority: int) -> None:
    # The daemon has already reported a missing permission.
    if priority:
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))


def _lock_memory() -> None:
    """Keep the pages of this process in memory, so that no disk access delays a moving cart."""
    import ctypes

    ctypes.CDLL(None).mlockall(MCL_CURRENT)


if __name__ == "__main__":
    main(sys.argv[1:])
