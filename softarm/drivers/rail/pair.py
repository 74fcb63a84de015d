"""Messages between the daemon and the rail's process, and the process's end of their socket pair.

One packet is one message: a begin message and set-points go to the process, reports come back. Every stamp is
CLOCK_MONOTONIC, which all processes of a host share.
"""

import contextlib
import socket
import struct
import time
from typing import NamedTuple

VERSION = 2
PACKET_MAX = 8192  # bytes
# Longest time between two reports.
HEARTBEAT_S = 0.05

_BEGIN = struct.Struct("<BB")
# Version, then the fields in their order.
_SET_POINT = struct.Struct("<BIq?dI")
# Version, number, out of operation, with a reading, with a problem; then the reading, homed as -1, 0 or 1.
_REPORT = struct.Struct("<BI???qdd??qqb")


class SetPoint(NamedTuple):
    """Command of the control loop.

    `number` counts the daemon's set-points, `t_ns` is the time of sending. `acknowledged` counts a person's
    acknowledgements; each increase requests a fault reset.
    """

    number: int
    t_ns: int
    enable: bool
    velocity_m_s: float
    acknowledged: int = 0


class Reading(NamedTuple):
    """Result of one poll of the drive: a lightweight `softarm.schemas.messages.RailReading`.

    `t_ns` is the time of the position request. The cycle times are the median and the maximum over the last second.
    `homed` is None if the drive does not report it.
    """

    t_ns: int
    position_m: float
    velocity_m_s: float
    enabled: bool
    remote: bool
    cycle_p50_ns: int
    cycle_max_ns: int
    faults: tuple[str, ...]
    homed: bool | None = None


_NO_READING = Reading(0, 0.0, 0.0, False, False, 0, 0, ())


class Report(NamedTuple):
    """State of the rail's process, sent after every poll and at least at the rate of its heartbeat.

    `received` is the number of the newest set-point. `out_of_operation` is the last known state of the drive.
    """

    received: int
    out_of_operation: bool
    reading: Reading | None
    problem: str | None


def encode_begin(may_move: bool) -> bytes:
    """Return the first packet, after which the process controls the drive, which may be in operation already."""
    return _BEGIN.pack(VERSION, may_move)


def decode_begin(packet: bytes) -> bool:
    """Return whether the drive may be in operation. Raises ValueError on another version or length."""
    if len(packet) != _BEGIN.size or packet[0] != VERSION:
        raise ValueError(f"{packet[:32].hex()} is not a begin message of version {VERSION}")
    return bool(packet[1])


def encode_set_point(message: SetPoint) -> bytes:
    """Return the packet of a set-point."""
    return _SET_POINT.pack(VERSION, *message)


def decode_set_point(packet: bytes) -> SetPoint:
    """Return the set-point in a packet. Raises ValueError on another version or length."""
    if len(packet) != _SET_POINT.size or packet[0] != VERSION:
        raise ValueError(f"{packet[:32].hex()} is not a set-point of version {VERSION}")
    return SetPoint._make(_SET_POINT.unpack(packet)[1:])


def encode_report(message: Report) -> bytes:
    """Return the packet of a report. Text beyond the end of the packet is cut."""
    received, out_of_operation, reading, problem = message
    *values, faults, homed = reading or _NO_READING
    known = (received, out_of_operation, reading is not None, problem is not None)
    head = _REPORT.pack(VERSION, *known, *values, -1 if homed is None else homed)
    return (head + "\0".join((problem or "", *faults)).encode())[:PACKET_MAX]


def decode_report(packet: bytes) -> Report:
    """Return the report in a packet. Raises ValueError on another version or on a packet that is too short."""
    if len(packet) < _REPORT.size or packet[0] != VERSION:
        raise ValueError(f"{packet[:32].hex()} is not a report of version {VERSION}")
    _, received, out_of_operation, has_reading, has_problem, *values, homed = _REPORT.unpack_from(packet)
    problem, *faults = packet[_REPORT.size :].decode(errors="replace").split("\0")
    reading = Reading._make((*values, tuple(faults), None if homed < 0 else bool(homed)))
    return Report(received, out_of_operation, reading if has_reading else None, problem if has_problem else None)


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
            return decode_set_point(self._line.recv(PACKET_MAX))
        except BlockingIOError:
            return None
        except (OSError, ValueError):
            self.closed = True
            raise HungUp from None

    def send(self, report: Report) -> None:
        """Send a report; a daemon that hangs or has ended is noticed elsewhere."""
        with contextlib.suppress(OSError):
            self._line.send(encode_report(report))
        self._reported_s = time.monotonic()
