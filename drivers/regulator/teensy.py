"""The messages between host and Teensy, which drives the pressure regulator; docs/wires.md has the table.

Both ends use this module: the driver and the twin's device (`softarm.drivers.twin.teensy`).
"""

import math
import struct
from dataclasses import dataclass
from enum import IntEnum, IntFlag

from softarm.schemas.robot import PRESSURE_MAX_KPA, PRESSURE_MIN_KPA

VERSION = 1
VENT_KPA = 0.0  # gauge: the muscle is open to the room
PRESSURE_RANGE_KPA = (PRESSURE_MIN_KPA, PRESSURE_MAX_KPA)  # what the device accepts as a set-point
TIME_TO_LIVE_MAX_S = 0.25  # the device refuses to be left alone for longer

_HEADER = struct.Struct("<BBII")  # version, type, sequence, sender's clock in microseconds (wraps)
_TOKEN = struct.Struct("<I")
_COMMAND = struct.Struct("<IHBf")  # token, time to live in ms, flags, set-point in kPa
_STATE = struct.Struct("<IBHf")  # last accepted sequence, flags, faults, measured pressure in kPa
_ARMED = 1


class Kind(IntEnum):
    """What a message is."""

    HELLO = 0x01  # host: I have just opened the port, which token do you want to hear?
    COMMAND = 0x02
    WELCOME = 0x81  # device: this one, until you open the port again
    STATE = 0x82


class Fault(IntFlag):
    """What the device holds against its host, by bit."""

    TIME_TO_LIVE = 1  # commands stopped while armed: vented, until a disarmed command and then an armed one
    TOKEN = 2  # the last command carried the wrong arm token: not accepted
    RANGE = 4  # the last command's set-point or time to live was out of range: not accepted
    SENSOR = 8  # the pressure sensor reads outside its own span
    SEQUENCE = 16  # the last command was no newer than one before it: not accepted

    def sentences(self) -> tuple[str, ...]:
        """One clause for each bit that is set, known here or not."""
        bits = [bit for bit in range(16) if self & 1 << bit]
        return tuple(_SENTENCE.get(Fault(1 << bit), _UNKNOWN.format(bit)) for bit in bits)


_SENTENCE = {
    Fault.TIME_TO_LIVE: "commands stopped, so the muscle was vented: disarm, then arm again",
    Fault.TOKEN: "the arm token is not the device's: the handshake is being repeated",
    Fault.RANGE: f"the command was out of range ({PRESSURE_RANGE_KPA[0]} to {PRESSURE_RANGE_KPA[1]} kPa, "
    f"time to live up to {TIME_TO_LIVE_MAX_S} s)",
    Fault.SENSOR: "the pressure sensor is outside its span: check its plug and supply",
    Fault.SEQUENCE: "a command came twice, or an old one late: check the cable",
}
_UNKNOWN = "fault bit {}, which this software does not know: update it, or see the firmware's notes"


@dataclass(frozen=True, slots=True)
class Hello:
    """The host has opened the port."""


@dataclass(frozen=True, slots=True)
class Welcome:
    """The device's answer to a hello: it is disarmed, venting, and knows the host by `token` from now on."""

    token: int


@dataclass(frozen=True, slots=True)
class RegulatorCommand:
    """An absolute set-point; harmless when repeated."""

    token: int
    time_to_live_s: float
    armed: bool
    pressure_kpa: float


@dataclass(frozen=True, slots=True)
class RegulatorState:
    """The device's answer to every command, accepted or not."""

    accepted_sequence: int
    armed: bool
    faults: Fault
    pressure_kpa: float


Message = Hello | Welcome | RegulatorCommand | RegulatorState


def is_newer(sequence: int, than: int) -> bool:
    """Whether a counter that wraps at 2^32 has advanced, by less than half its range."""
    return 0 < (sequence - than) % 2**32 < 2**31


def encode(message: Message, sequence: int, time_us: int) -> bytes:
    """The body of a frame (see `softarm.drivers.regulator.cobs.frame`). Counters are taken modulo 2^32."""
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
    """The message in a frame's body, and its sequence. Raises ValueError with what is wrong."""
    if len(body) < _HEADER.size:
        raise ValueError(f"a message of {len(body)} bytes; the header alone takes {_HEADER.size}")
    version, kind, sequence, _ = _HEADER.unpack_from(body)
    if version != VERSION:
        raise ValueError(f"protocol version {version}, this software speaks {VERSION}: update the older side")
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
    raise ValueError(f"message type 0x{kind:02x} with {len(payload)} bytes of payload is not one of ours")
