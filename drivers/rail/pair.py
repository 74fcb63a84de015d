"""What the daemon and the rail's process say to each other: one packet of a socket pair is one message.

A beginning and set-points go down, reports come up. Every stamp is CLOCK_MONOTONIC, which a host's processes share.
"""

import struct
from typing import NamedTuple

VERSION = 1
PACKET_MAX = 8192  # bytes

_BEGIN = struct.Struct("<BB")
_SET_POINT = struct.Struct("<BBIIqd")
_REPORT = struct.Struct("<BBIqqqdd")
_ENABLE = 1
_AT_EASE, _READING, _ENABLED, _REMOTE, _PROBLEM, _HOMED, _NOT_HOMED = (1 << bit for bit in range(7))
_SAID = {True: _HOMED, False: _NOT_HOMED, None: 0}


class SetPoint(NamedTuple):
    """What the control loop wants, and since when."""

    number: int  # the daemon's count
    t_ns: int  # when it was sent
    enable: bool
    velocity_m_s: float
    acknowledged: int = 0  # how often a person has acknowledged: one more asks for a fault reset


class Reading(NamedTuple):
    """What one poll of the drive found; `softarm.schemas.messages.RailReading` without its weight."""

    t_ns: int  # when the position was asked for
    position_m: float
    velocity_m_s: float
    enabled: bool
    remote: bool
    cycle_p50_ns: int  # of the exchanges that make a cycle, over the last second
    cycle_max_ns: int
    faults: tuple[str, ...]
    homed: bool | None = None  # as the drive says; None: it does not


class Report(NamedTuple):
    """How the rail's process fares; sent after every poll, and often enough in between to show that it lives."""

    taken: int  # number of the newest set-point that it heard
    at_ease: bool  # as far as it knows, the drive is out of operation
    reading: Reading | None  # the newest; None before the first
    problem: str | None


def encode_begin(may_move: bool) -> bytes:
    """The first packet: from now on this process leads the drive. `may_move`: as far as is known it is in operation."""
    return _BEGIN.pack(VERSION, may_move)


def decode_begin(packet: bytes) -> bool:
    """Raises ValueError on a packet of another version or length."""
    if len(packet) != _BEGIN.size or packet[0] != VERSION:
        raise ValueError(f"{packet[:32].hex()} is no beginning of version {VERSION}")
    return bool(packet[1])


def encode_set_point(message: SetPoint) -> bytes:
    """As a packet."""
    number, t_ns, enable, velocity_m_s, acknowledged = message
    return _SET_POINT.pack(VERSION, _ENABLE if enable else 0, number, acknowledged, t_ns, velocity_m_s)


def decode_set_point(packet: bytes) -> SetPoint:
    """Raises ValueError on a packet of another version or length."""
    if len(packet) != _SET_POINT.size or packet[0] != VERSION:
        raise ValueError(f"{packet[:32].hex()} is no set-point of version {VERSION}")
    _, flags, number, acknowledged, t_ns, velocity_m_s = _SET_POINT.unpack(packet)
    return SetPoint(number, t_ns, bool(flags & _ENABLE), velocity_m_s, acknowledged)


def encode_report(message: Report) -> bytes:
    """As a packet; sentences beyond its end are cut."""
    flags = (_AT_EASE if message.at_ease else 0) | (_PROBLEM if message.problem is not None else 0)
    if message.reading is None:
        head = _REPORT.pack(VERSION, flags, message.taken, 0, 0, 0, 0.0, 0.0)
        faults: tuple[str, ...] = ()
    else:
        t_ns, position_m, velocity_m_s, enabled, remote, p50_ns, max_ns, faults, homed = message.reading
        flags |= _READING | _SAID[homed] | (_ENABLED if enabled else 0) | (_REMOTE if remote else 0)
        head = _REPORT.pack(VERSION, flags, message.taken, t_ns, p50_ns, max_ns, position_m, velocity_m_s)
    return (head + "\0".join((message.problem or "", *faults)).encode())[:PACKET_MAX]


def decode_report(packet: bytes) -> Report:
    """Raises ValueError on a packet of another version, or one that is too short."""
    if len(packet) < _REPORT.size or packet[0] != VERSION:
        raise ValueError(f"{packet[:32].hex()} is no report of version {VERSION}")
    _, flags, taken, t_ns, p50_ns, max_ns, position_m, velocity_m_s = _REPORT.unpack_from(packet)
    problem, *faults = packet[_REPORT.size :].decode(errors="replace").split("\0")
    enabled, remote = bool(flags & _ENABLED), bool(flags & _REMOTE)
    homed = next(said for said, flag in _SAID.items() if flags & flag == flag)
    reading = Reading(t_ns, position_m, velocity_m_s, enabled, remote, p50_ns, max_ns, tuple(faults), homed)
    return Report(
        taken,
        bool(flags & _AT_EASE),
        reading if flags & _READING else None,
        problem if flags & _PROBLEM else None,
    )
