"""The process's end of the socket pair to the daemon."""

import contextlib
import socket
import time

from softarm.drivers.rail import pair
from softarm.drivers.rail.pair import Report, SetPoint

# Longest time between two reports.
HEARTBEAT_S = 0.05


class HungUp(Exception):
    """The daemon has closed its end or has ended."""


class DaemonLine:
    """Non-blocking line to the daemon. `closed` is true once the daemon has hung up."""

    def __init__(self, line: socket.socket) -> None:
        line.setblocking(False)
        self.closed = False
        self._line = line
        self._reported_s = 0.0

    def fileno(self) -> int:
        """Return the descriptor to poll for set-points."""
        return self._line.fileno()

    @property
    def report_due_in_s(self) -> float:
        """Time until the next heartbeat is due; negative when it is late."""
        return self._reported_s + HEARTBEAT_S - time.monotonic()

    def receive(self) -> SetPoint | None:
        """Return the next set-point, or None if none is waiting. Raises HungUp."""
        try:
            return pair.decode_set_point(self._line.recv(pair.PACKET_MAX))
        except BlockingIOError:
            return None
        except (OSError, ValueError):
            self.closed = True
            raise HungUp from None

    def send(self, report: Report) -> None:
        """Send a report; a daemon that hangs or has ended is noticed elsewhere."""
        with contextlib.suppress(OSError):
            self._line.send(pair.encode_report(report))
        self._reported_s = time.monotonic()
