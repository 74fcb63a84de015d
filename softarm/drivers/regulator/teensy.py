"""Messages between the host and the Teensy of the pressure regulator (table: docs/reference/wires.md).

Both ends use this module: the driver and the twin's device (`softarm.drivers.twin.teensy`).
"""

import math
import struct
from dataclasses import dataclass
from enum import IntEnum, IntFlag

from softarm.schemas.robot import PRESSURE_MAX_KPA, PRESSURE_MIN_KPA

VERSION = 1
# Gauge pressure of a muscle that is open to the air.
VENT_KPA = 0.0
# Set-points that the device accepts.
PRESSURE_RANGE_KPA = (PRESSURE_MIN_KPA, PRESSURE_MAX_KPA)
# The device rejects commands with a longer time to live.
TIME_TO_LIVE_MAX_S = 0.25

_HEADER = struct.Struct("<BBII")  # version, type, sequence, sender's clock in microseconds (wraps)
_TOKEN = struct.Struct("<I")
_COMMAND = struct.Struct("<IHBf")  # token, time to live in ms, flags, set-point in kPa
_STATE = struct.Struct("<IBHf")  # last accepted sequence, flags, faults, measured pressure in kPa
_ARMED = 1


class Kind(IntEnum):
    """Message types. The host opens the port with HELLO; the device answers with its token in WELCOME."""

    HELLO = 0x01
    COMMAND = 0x02
    WELCOME = 0x81
    STATE = 0x82


class Fault(IntFlag):
    """Faults that the device reports, by bit.

    TIME_TO_LIVE: commands stopped while armed; vented until a disarmed and then an armed command. TOKEN, RANGE and
    SEQUENCE: the last command was rejected for its arm token, its set-point or time to live, or because it was not
    newer than an earlier one. SENSOR: the pressure sensor reads outside its span.
    """

    TIME_TO_LIVE = 1
    TOKEN = 2
    RANGE = 4
    SENSOR = 8
    SEQUENCE = 16

    def sentences(self) -> tuple[str, ...]:
        """Return one clause for each bit that is set, including unknown bits."""
        bits = [bit for bit in range(16) if self & 1 << bit]
        return tuple(_SENTENCE.get(Fault(1 << bit), _UNKNOWN.format(bit)) for bit in bits)


_SENTENCE = {
    Fault.TIME_TO_LIVE: "commands stopped, so the muscle was vented: disarm, then arm again",
    Fault.TOKEN: "the arm token was wrong: the handshake is being repeated",
    Fault.RANGE: f"the command was out of range (allowed: {PRESSURE_RANGE_KPA[0]} to {PRESSURE_RANGE_KPA[1]} kPa, "
    f"time to live up to {TIME_TO_LIVE_MAX_S} s)",
    Fault.SENSOR: "the pressure sensor is outside its span: check its plug and supply",
    Fault.SEQUENCE: "a command arrived twice or late: check the cable",
}
_UNKNOWN = "unknown fault bit {}: update this software, or read the firmware's notes"


@dataclass(frozen=True, slots=True)
class Hello:
    """Message of the host: the port has been opened."""


@dataclass(frozen=True, slots=True)
class Welcome:
    """Answer to a hello: the device is disarmed, vents, and accepts commands with `token` from now on."""

    token: int


@dataclass(frozen=True, slots=True)
class RegulatorCommand:
    """Command with an absolute set-point, harmless when repeated."""

    token: int
    time_to_live_s: float
    armed: bool
    pressure_kpa: float


@dataclass(frozen=True, slots=True)
class RegulatorState:
    """Answer to every command, accepted or not."""

    accepted_sequence: int
    armed: bool
    faults: Fault
    pressure_kpa: float


Message = Hello | Welcome | RegulatorCommand | RegulatorState


def is_newer(sequence: int, than: int) -> bool:
    """Return whether a counter that wraps at 2^32 has advanced by less than half its range."""
    return 0 < (sequence - than) % 2**32 < 2**31


def encode(message: Message, sequence: int, time_us: int) -> bytes:
    """Return the body of a frame (see `softarm.drivers.regulator.cobs.frame`); sequence and clock wrap at 2^32."""
    match message:
        case Hello():
            kind, payload = Kind.HELLO, b""
        case Welcome():
            kind, payload = Kind.WELCOME, _TOKEN.pack(message.token)
        case RegulatorCommand():
            time_to_live_ms = round(message.time_to_live_s * 1000)
            payload = _COMMAND.pack(message.token, time_to_live_ms, message.armed, message.pressure_kpa)
            kind = Kind.COMMAND
        case RegulatorState():
            payload = _STATE.pack(message.accepted_sequence, message.armed, message.faults, message.pressure_kpa)
            kind = Kind.STATE
    return _HEADER.pack(VERSION, kind, sequence & 0xFFFFFFFF, time_us & 0xFFFFFFFF) + payload


def decode(body: bytes) -> tuple[Message, int]:
    """Return the message in a frame's body and its sequence. Raises ValueError on an invalid body."""
    if len(body) < _HEADER.size:
        raise ValueError(f"a message of {len(body)} bytes; the header alone takes {_HEADER.size}")
    version, kind, sequence, _ = _HEADER.unpack_from(body)
    if version != VERSION:
        raise ValueError(f"protocol version {version}, this software supports {VERSION}: update the older side")
    payload = body[_HEADER.size :]
    try:
        match kind:
            case Kind.HELLO if not payload:
                return Hello(), sequence
            case Kind.WELCOME:
                return Welcome(*_TOKEN.unpack(payload)), sequence
            case Kind.COMMAND:
                token, time_to_live_ms, flags, pressure_kpa = _COMMAND.unpack(payload)
                return RegulatorCommand(token, time_to_live_ms / 1000, bool(flags & _ARMED), pressure_kpa), sequence
            case Kind.STATE:
                accepted, flags, faults, pressure_kpa = _STATE.unpack(payload)
                if math.isfinite(pressure_kpa):
                    return RegulatorState(accepted, bool(flags & _ARMED), Fault(faults), pressure_kpa), sequence
                raise ValueError(f"a measured pressure of {pressure_kpa}")
    except struct.error as error:
        raise ValueError(f"message type 0x{kind:02x} with {len(payload)} bytes of payload: {error}") from None
    raise ValueError(f"message type 0x{kind:02x} with {len(payload)} bytes of payload is unknown")
