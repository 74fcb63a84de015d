"""Firmware of the regulator board: COBS frames on a pseudo-terminal, without a clock of its own."""

import binascii
import contextlib
import os
import select
import struct
import threading
import time
import tty
from collections.abc import Callable

_HELLO, _WELCOME, _COMMAND, _STATE = 0x01, 0x81, 0x02, 0x82
_HEAD = struct.Struct("<BBII")
_CALL = struct.Struct("<IHBf")
_SAY = struct.Struct("<IBHf")
_LENGTHS = {_HELLO: _HEAD.size, _COMMAND: _HEAD.size + _CALL.size}
_TTL, _TOKEN, _RANGE, _SEQUENCE = 1, 2, 4, 16
_REFUSALS = _TOKEN | _RANGE | _SEQUENCE
_CRC_INIT = 0xFFFF  # CRC-16/IBM-3740
_UNPLUGGED_S = 0.01


def stuff(body: bytes) -> bytes:
    """Return a frame with its final zero; the body is shorter than 252 bytes."""
    data = body + struct.pack("<H", binascii.crc_hqx(body, _CRC_INIT))
    return b"".join(bytes([len(run) + 1]) + run for run in data.split(b"\0")) + b"\0"


def unstuff(frame: bytes) -> bytes | None:
    """Return the body of a frame given without its zero, or None if it is invalid."""
    data, at = bytearray(), 0
    while at < len(frame):
        end = at + frame[at]
        if end > len(frame):
            return None
        data += frame[at + 1 : end]
        if frame[at] < 0xFF and end < len(frame):
            data.append(0)
        at = end
    if len(data) < 3 or binascii.crc_hqx(data[:-2], _CRC_INIT) != int.from_bytes(data[-2:], "little"):
        return None
    return bytes(data[:-2])


class Firmware:
    """State machine of the board: bytes and the time in, answers and a set-point out."""

    def __init__(self) -> None:
        self.armed = False
        self.set_kpa = 0.0
        self._faults = 0
        self._token: int | None = None
        self._newest = self._accepted = self._count = 0
        self._ready = False  # a disarmed command was received
        self._ends_us = 0
        self._line = bytearray()
        self._lost = False  # too many bytes without a zero

    def _vent(self) -> None:
        self.armed, self.set_kpa = False, 0.0

    def run(self, now_us: int) -> None:
        """Vent when commands have stopped."""
        if self.armed and now_us >= self._ends_us:
            self._vent()
            self._ready = False
            self._faults |= _TTL

    def receive(self, data: bytes, now_us: int, sensor_kpa: float) -> bytes:
        """Process received bytes and return the answers to the frames that they complete."""
        answers = b""
        for byte in data:
            if byte:
                self._line.append(byte)
                if len(self._line) > 256:
                    self._lost = True
                    self._line.clear()
                continue
            frame, lost = bytes(self._line), self._lost
            self._line.clear()
            self._lost = False
            body = unstuff(frame) if frame and not lost else None
            if body is not None:
                answers += self._handle(body, now_us, sensor_kpa)
        return answers

    def _say(self, kind: int, now_us: int, payload: bytes) -> bytes:
        self._count = self._count + 1 & 0xFFFFFFFF
        return stuff(_HEAD.pack(1, kind, self._count, now_us & 0xFFFFFFFF) + payload)

    def _handle(self, body: bytes, now_us: int, sensor_kpa: float) -> bytes:
        if len(body) < _HEAD.size:
            return b""
        version, kind, sequence, _ = _HEAD.unpack_from(body)
        if version != 1 or _LENGTHS.get(kind) != len(body):
            return b""
        self.run(now_us)
        if kind == _HELLO:
            self._vent()
            self._ready = False
            self._accepted, self._newest = 0, sequence
            self._token = int.from_bytes(os.urandom(4), "little")
            return self._say(_WELCOME, now_us, struct.pack("<I", self._token))
        refusal = self._carry_out(sequence, body[_HEAD.size :], now_us)
        self._faults = self._faults & ~_REFUSALS | refusal
        say = _SAY.pack(self._accepted, int(self.armed), self._faults, sensor_kpa)
        return self._say(_STATE, now_us, say)

    def _carry_out(self, sequence: int, call: bytes, now_us: int) -> int:
        """Carry out a command; return the fault bit of its refusal, or 0."""
        token, ttl_ms, flags, kpa = _CALL.unpack(call)
        if token != self._token:
            return _TOKEN
        if not 1 <= (sequence - self._newest & 0xFFFFFFFF) <= 0x7FFFFFFF:
            return _SEQUENCE
        if not -0.7 <= kpa <= 20 or not 1 <= ttl_ms <= 250:
            return _RANGE
        self._newest = self._accepted = sequence
        self._ends_us = now_us + ttl_ms * 1000
        if not flags & 1:
            self._vent()
            self._ready = True
            self._faults &= ~_TTL
        elif self._ready:
            self.armed, self.set_kpa = True, kpa
        return 0


class Board:
    """Firmware behind a pseudo-terminal at the symbolic link `path`, read by a separate thread.

    The thread that steps the body must not read: a pseudo-terminal may wait for a kernel worker of ordinary priority.
    """

    def __init__(self, firmware: Firmware, path: str, sensor_kpa: Callable[[], float]) -> None:
        self._firmware, self._path, self._sensor_kpa = firmware, path, sensor_kpa
        self._lock = threading.Lock()
        self._master, slave = os.openpty()
        tty.setraw(slave)
        if os.path.islink(path):
            os.unlink(path)
        os.symlink(os.ttyname(slave), path)
        # This process does not keep the slave open: a host's TIOCEXCL would outlive the host.
        os.close(slave)
        os.set_blocking(self._master, False)
        threading.Thread(target=self._listen, daemon=True).start()

    def watch(self) -> None:
        """Vent when commands have stopped, without waiting for the line."""
        with self._lock:
            self._firmware.run(_now_us())

    def close(self) -> None:
        """Remove the pseudo-terminal again."""
        if os.path.islink(self._path):
            os.unlink(self._path)

    def _listen(self) -> None:
        poll = select.poll()
        poll.register(self._master, select.POLLIN)
        while True:
            poll.poll()
            try:
                data = os.read(self._master, 4096)
            except BlockingIOError:
                continue
            except OSError:  # no host has it open
                time.sleep(_UNPLUGGED_S)
                continue
            with self._lock:
                answer = self._firmware.receive(data, _now_us(), self._sensor_kpa())
            with contextlib.suppress(OSError):  # a host that does not read loses answers
                os.write(self._master, answer)


def _now_us() -> int:
    return time.monotonic_ns() // 1000
