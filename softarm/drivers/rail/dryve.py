"""Telegrams of the igus dryve D1: CANopen objects in Modbus TCP, function 0x2B, MEI type 0x0D.

Source: dryve D1 Operating Manual V2.4, pages 103 to 110; the byte lists of igus' sample programs. Header and
object index are big-endian, data little-endian. The module has few imports, because the rail's process starts with it.
"""

from typing import NamedTuple

FUNCTION, MEI_TYPE = 0x2B, 0x0D
EXCEPTION = FUNCTION | 0x80
EXTENDED_EXCEPTION, ABORT = 0xFF, 0xCE
_MBAP_BYTES = 6  # transaction id, protocol, length of what follows
_FIXED_BYTES = 13  # unit id to byte count
_LENGTH_MAX = 64

EXCEPTIONS = {
    0x01: "illegal function",
    0x02: "illegal address",
    0x03: "illegal value",
    0x04: "device failure",
    0x05: "acknowledged, not done yet",
    0x06: "busy",
}
# CiA 301, table 22: SDO abort codes.
ABORTS = {
    0x05040000: "SDO protocol timed out",
    0x05040001: "command specifier unknown",
    0x06010000: "unsupported access to the object",
    0x06010001: "the object is write-only",
    0x06010002: "the object is read-only",
    0x06020000: "the object does not exist",
    0x06040043: "parameters are incompatible",
    0x06060000: "access failed: hardware error",
    0x06070010: "the length does not match the object's",
    0x06070012: "too many bytes for the object",
    0x06070013: "too few bytes for the object",
    0x06090011: "the sub-index does not exist",
    0x06090030: "the value is out of range",
    0x06090031: "the value is too high",
    0x06090032: "the value is too low",
    0x08000000: "general error",
    0x08000020: "the value cannot be transferred",
    0x08000021: "refused: the drive is under local control",
    0x08000022: "refused in the drive's present state",
}
# 603Fh, from the drive's error list (E01 to E21).
ERROR_CODES = {
    0x6320: "E01 configuration",
    0x2320: "E02 motor over-current",
    0x2311: "E03 encoder over-current",
    0x2312: "E04 output over-current",
    0x5114: "E05 I/O supply low",
    0x3222: "E06 logic supply low",
    0x3112: "E07 logic supply high",
    0x3221: "E08 load supply low",
    0x3211: "E09 load supply high",
    0x4310: "E10 temperature",
    0x8611: "E11 following error",
    0xFF00: "E12 limit switch",
    0x7306: "E13 hall sensor",
    0x7305: "E14 encoder",
    0xFF01: "E15 encoder channel A",
    0xFF02: "E16 encoder channel B",
    0xFF03: "E17 encoder index",
    0x7110: "E21 brake resistor",
}


class Entry(NamedTuple):
    """Entry of the drive's object dictionary; `size` in bytes."""

    name: str
    index: int  # type: ignore[assignment]
    sub: int
    size: int
    signed: bool = False

    def __str__(self) -> str:
        return f"{self.index:04X}h:{self.sub} ({self.name})"


ERROR_CODE = Entry("error code", 0x603F, 0, 2)
CONTROLWORD = Entry("controlword", 0x6040, 0, 2)
STATUSWORD = Entry("statusword", 0x6041, 0, 2)
MODE = Entry("mode of operation", 0x6060, 0, 1, signed=True)
MODE_DISPLAY = Entry("mode of operation display", 0x6061, 0, 1, signed=True)
POSITION = Entry("position actual", 0x6064, 0, 4, signed=True)
VELOCITY = Entry("velocity actual", 0x606C, 0, 4, signed=True)
ACCELERATION = Entry("profile acceleration", 0x6083, 0, 4)
DECELERATION = Entry("profile deceleration", 0x6084, 0, 4)
QUICK_STOP = Entry("quick-stop deceleration", 0x6085, 0, 4)
TARGET_VELOCITY = Entry("target velocity", 0x60FF, 0, 4, signed=True)
# The D1's homing method is set on its web page.
HOMING_METHOD = Entry("homing method", 0x6098, 0, 1, signed=True)
HOMING_SPEED = Entry("homing speed, towards the switch", 0x6099, 1, 4)
HOMING_CREEP = Entry("homing speed, towards the zero", 0x6099, 2, 4)
HOMING_ACCELERATION = Entry("homing acceleration", 0x609A, 0, 4)
# A vendor object, optional; bit 0: homed.
HOMING_STATUS = Entry("homing status", 0x2014, 0, 2)
# Values of MODE.
PROFILE_VELOCITY, HOMING = 3, 6


class DryveRefusal(Exception):
    """Error answer of the drive, as a sentence."""


class DryveMismatch(Exception):
    """Answer that does not fit the request."""


class ModbusRequest(NamedTuple):
    """Request to read `count` bytes, or to write `data` of `count` bytes."""

    transaction: int
    index: int  # type: ignore[assignment]
    sub: int
    count: int  # type: ignore[assignment]
    data: bytes | None = None


def encode_request(transaction: int, entry: Entry, value: int | None = None) -> bytes:
    """Return a read request, or with `value` a write request. Raises OverflowError if the value does not fit."""
    data = b"" if value is None else value.to_bytes(entry.size, "little", signed=entry.signed)
    return _telegram(transaction, value is not None, entry.index, entry.sub, entry.size, data)


def decode_answer(telegram: bytes, transaction: int, entry: Entry, write: bool) -> int:
    """Return the value read, or 0 for the acknowledgement of a write.

    Raises:
        DryveRefusal: The drive sent an error answer (9 or 17 bytes).
        DryveMismatch: The answer belongs to another request.
    """
    if int.from_bytes(telegram[:2], "big") != transaction:
        raise DryveMismatch(f"transaction {int.from_bytes(telegram[:2], 'big')}, not {transaction}")
    if len(telegram) >= 9 and telegram[7] == EXCEPTION:
        raise DryveRefusal(f"{entry}: {_exception(telegram)}")
    head = bytes((FUNCTION, MEI_TYPE, write, 0, 0)) + entry.index.to_bytes(2, "big") + bytes((entry.sub,))
    if len(telegram) < 19 or telegram[7:15] != head:
        raise DryveMismatch(f"{telegram.hex()} is not an answer to a request for {entry}")
    data = telegram[19:]
    if len(data) != telegram[18] or len(data) > entry.size or bool(data) == write:
        raise DryveMismatch(f"{telegram.hex()} has {len(data)} bytes for {entry}, declared {telegram[18]}")
    if not write and len(data) < entry.size and (entry.signed or entry.size < 4):
        # The D1 may shorten a long answer, which makes a signed value ambiguous.
        raise DryveMismatch(f"{len(data)} bytes for {entry}, which has {entry.size}")
    return int.from_bytes(data, "little", signed=entry.signed)


def decode_request(telegram: bytes) -> ModbusRequest:
    """Return the request in a telegram, as the drive does. Raises ValueError on anything else."""
    write = telegram[9:10] == b"\x01"
    if len(telegram) < 19 or telegram[2:4] != b"\0\0" or telegram[7:9] != bytes((FUNCTION, MEI_TYPE)):
        raise ValueError(f"{telegram.hex()} is not a request")
    count, data = telegram[18], telegram[19:]
    if len(data) != (count if write else 0):
        raise ValueError(f"{telegram.hex()} carries {len(data)} bytes, declared {count}")
    index = int.from_bytes(telegram[12:14], "big")
    return ModbusRequest(int.from_bytes(telegram[:2], "big"), index, telegram[14], count, data if write else None)


def encode_value(request: ModbusRequest, data: bytes) -> bytes:
    """Return the drive's answer to a read request."""
    return _telegram(request.transaction, False, request.index, request.sub, len(data), data)


def encode_acknowledgement(request: ModbusRequest) -> bytes:
    """Return the drive's answer to a write request."""
    return _telegram(request.transaction, True, request.index, request.sub, 0, b"")


def encode_exception(transaction: int, code: int) -> bytes:
    """Return the 9-byte error answer (manual, page 110)."""
    return _prefix(transaction, 3) + bytes((0, EXCEPTION, code))


def encode_abort(transaction: int, abort: int) -> bytes:
    """Return the 17-byte error answer that real drives send; it ends in the SDO abort code."""
    body = bytes((0, EXCEPTION, EXTENDED_EXCEPTION, 0, 6, MEI_TYPE, ABORT)) + abort.to_bytes(4, "little")
    return _prefix(transaction, len(body)) + body


class Telegrams:
    """Splitter of a TCP stream into telegrams, by the length in their headers."""

    def __init__(self) -> None:
        self._pending = b""

    def feed(self, data: bytes) -> None:
        """Append received bytes to the stream."""
        self._pending += data

    def next(self) -> bytes | None:
        """Return the next telegram, or None if it is incomplete.

        Raises:
            ValueError: The header is invalid; all pending bytes are dropped.
        """
        if len(self._pending) < _MBAP_BYTES:
            return None
        head, length = self._pending[:_MBAP_BYTES], int.from_bytes(self._pending[4:_MBAP_BYTES], "big")
        if head[2:4] != b"\0\0" or not 3 <= length <= _LENGTH_MAX:
            self._pending = b""
            raise ValueError(
                f"{head.hex()} is not a telegram's header: protocol 0 and 3 to {_LENGTH_MAX} bytes are allowed, "
                f"here {length} bytes"
            )
        end = _MBAP_BYTES + length
        if len(self._pending) < end:
            return None
        telegram, self._pending = self._pending[:end], self._pending[end:]
        return telegram


def _telegram(transaction: int, write: bool, index: int, sub: int, count: int, data: bytes) -> bytes:
    object_id = index.to_bytes(2, "big") + bytes((sub, 0, 0, 0, count))
    fixed = bytes((0, FUNCTION, MEI_TYPE, write, 0, 0)) + object_id
    return _prefix(transaction, _FIXED_BYTES + len(data)) + fixed + data


def _prefix(transaction: int, length: int) -> bytes:
    return transaction.to_bytes(2, "big") + b"\0\0" + length.to_bytes(2, "big")


def _exception(telegram: bytes) -> str:
    code = telegram[8]
    if code == EXTENDED_EXCEPTION and len(telegram) == 17 and telegram[12] == ABORT:
        abort = int.from_bytes(telegram[13:17], "little")
        return f"{ABORTS.get(abort, 'refused')} (SDO abort 0x{abort:08X})"
    return f"{EXCEPTIONS.get(code, 'refused')} (Modbus exception 0x{code:02X})"
