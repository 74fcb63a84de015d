"""Drive of the rail: telegrams over Modbus TCP, the CiA 402 state machine, ramps and a velocity servo."""

import collections
import contextlib
import socket
import struct

OFF, _READY, _ON, RUN, _QUICK, _REACTION, _FAULT = 0x40, 0x21, 0x23, 0x27, 0x07, 0x0F, 0x08
_AFTER = {_QUICK: OFF, _REACTION: _FAULT}  # state while braking -> state at rest
_REMOTE = 0x200  # enable input
_UNITS = 100_000  # per metre
_CENTRE_M = 0.30
_SILENCE_S = 0.1
_SERVO_NS_M, _SERVO_N_M = 30.0, 150.0  # velocity loop, proportional and integral gain
_FORWARD_KG = 0.5
_SLIPS_M_S = 0.02  # friction is compensated above this speed
_FORCE_N = 40.0
_WIDE_M_S, _WIDE_S = 0.5, 0.1  # following error, and its duration, that trip the drive
_FOLLOWING = 0x8611
_FREE_NS_M = 4.0  # a motor without power
_REST_M_S = 0.01

_SWITCH_M = 0.29  # closed beyond this position; homing searches its edge
_POSITIVE_SWITCH = 18  # the homing method
_START, _HALT = 0x10, 0x100

# index, or index and sub-index: (bytes, signed, writable)
_OBJECTS: dict[int | tuple[int, int], tuple[int, bool, bool]] = {
    0x6040: (2, False, True), 0x6041: (2, False, False), 0x603F: (2, False, False),
    0x6060: (1, True, True), 0x6061: (1, True, False),
    0x6083: (4, False, True), 0x6084: (4, False, True), 0x6085: (4, False, True),
    0x60FF: (4, True, True), 0x6064: (4, True, False), 0x606C: (4, True, False),
    0x2014: (2, False, False), 0x6098: (1, True, False), 0x609A: (4, False, True),
    (0x6099, 1): (4, False, True), (0x6099, 2): (4, False, True),
}  # fmt: skip


class Zero:
    """Reference of the axis, and the search for it: out to the switch, slowly back to its edge."""

    def __init__(self, homed: bool, start_m: float) -> None:
        self.homed = homed
        self.off_m = 0.0 if homed else -start_m - _CENTRE_M  # the counter starts at zero
        self.found = self.failed = False
        self._way = 0  # +1 out, -1 back, 0 none

    def command(self, before: int, word: int) -> None:
        """Process a controlword in operation in homing mode."""
        if word & _HALT or not word & _START:
            self._way = 0
        elif not before & _START:
            self.found = self.failed = False
            self._way = 1

    def leave(self) -> None:
        """Abort the search, because the drive left operation or homing mode."""
        self._way = 0

    def target(self, y: float, out_m_s: float, back_m_s: float) -> float:
        """Return the target velocity of the search."""
        if self._way > 0 and y > _SWITCH_M:
            self._way = -1
        elif self._way < 0 and y <= _SWITCH_M:
            self._way, self.found, self.homed, self.off_m = 0, True, True, 0.0
        if self._way and not (out_m_s and back_m_s):
            self._way, self.failed = 0, True
        return (0.0, out_m_s, -back_m_s)[self._way]

    def bits(self) -> int:
        """Return bits 13, 12 and 10 of 6041h."""
        return self.failed << 13 | self.found << 12 | (not self._way) << 10


class Drive:
    """One drive, homed by default and with its enable input high.

    Args:
        latency_s: Delay from a written 60FFh to the start of the ramp.
        keep: Keep the last set-point when the master is gone or silent.
        friction_n: Friction of axis and motor that the servo compensates.
        unreferenced_at_m: Position of a drive that was just switched on.
    """

    def __init__(
        self, latency_s: float, keep: bool, friction_n: float = 0.0, unreferenced_at_m: float | None = None
    ) -> None:
        self._latency_s, self._keep = latency_s, keep
        self._values: dict[int | tuple[int, int], int] = dict.fromkeys(_OBJECTS, 0)
        self._values |= {0x6083: _UNITS, 0x6084: _UNITS, 0x6085: _UNITS, 0x6098: _POSITIVE_SWITCH}
        self._zero = Zero(unreferenced_at_m is None, unreferenced_at_m or 0.0)
        self._friction_n = friction_n
        self.state = OFF
        self._coming: collections.deque[tuple[float, float]] = collections.deque()  # set-points not yet effective
        self._target = self._ref = self._sum_n = 0.0
        self._y = self._v = 0.0
        self._received = 0.0
        self._wide_s = 0.0

    @property
    def powered(self) -> bool:
        """Return whether the motor holds the cart."""
        return self.state in (RUN, *_AFTER)

    def step(self, h: float, now: float, y: float, v: float) -> tuple[float, float]:
        """Return the motor's force (N) and its stiffness against velocity (N s/m) for a step of `h` s from `now`."""
        self._y, self._v = y, v
        while self._coming and self._coming[0][0] <= now:
            self._target = self._coming.popleft()[1]
        if self.state == RUN and not self._keep and now - self._received > _SILENCE_S:
            self.state = _QUICK
        if not self.powered:
            self._zero.leave()
            self._ref, self._sum_n = v, 0.0
            return 0.0, _FREE_NS_M
        before = self._ref
        self._ramp(h, y)
        if self.state in _AFTER and self._ref == 0.0 and abs(v) < _REST_M_S:
            self.state = _AFTER[self.state]
        return self._servo(h, (self._ref - before) / h, self._ref - v)

    def _wanted(self, y: float) -> float:
        """Return the velocity that the servo's reference approaches."""
        if self._values[0x6060] == 6 and self.state == RUN:
            return self._zero.target(y, self._values[0x6099, 1] / _UNITS, self._values[0x6099, 2] / _UNITS)
        self._zero.leave()
        stands = self.state in _AFTER or self._values[0x6040] & _HALT or self._values[0x6060] != 3
        return 0.0 if stands else self._target

    def _ramp(self, h: float, y: float) -> None:
        """Move the servo's reference towards the target."""
        quick, target = self.state in _AFTER, self._wanted(y)
        faster = target * self._ref >= 0 and abs(target) > abs(self._ref)
        searching = target and self._values[0x6060] == 6
        ramp = 0x6085 if quick else 0x609A if searching else 0x6083 if faster else 0x6084
        most = self._values[ramp] / _UNITS * h
        self._ref += max(-most, min(most, target - self._ref))

    def _servo(self, h: float, feed_m_s2: float, error_m_s: float) -> tuple[float, float]:
        self._wide_s = self._wide_s + h if abs(error_m_s) > _WIDE_M_S else 0.0
        if self._wide_s > _WIDE_S:
            self.trip(_FOLLOWING)
        self._sum_n = max(-_FORCE_N / 2, min(_FORCE_N / 2, self._sum_n + _SERVO_N_M * error_m_s * h))
        force_n = self._friction_n * max(-1.0, min(1.0, self._ref / _SLIPS_M_S))
        force_n += _FORWARD_KG * feed_m_s2 + _SERVO_NS_M * error_m_s + self._sum_n
        if abs(force_n) > _FORCE_N:
            return (_FORCE_N if force_n > 0 else -_FORCE_N), 0.0
        return force_n, _SERVO_NS_M

    def trip(self, code: int) -> None:
        """Enter the fault with this 603Fh after braking."""
        if self.state not in (_REACTION, _FAULT):
            self.state = _REACTION if self.powered else _FAULT
            self._values[0x603F] = code

    def hang_up(self) -> None:
        """React to a lost master."""
        if self.state == RUN and not self._keep:
            self.state = _QUICK

    def _control(self, word: int) -> None:
        before, self._values[0x6040] = self._values[0x6040], word
        if self.state == RUN and self._values[0x6060] == 6:
            self._zero.command(before, word)
        if self.state == _REACTION:
            pass
        elif self.state == _FAULT:
            if word & 0x80 and not before & 0x80:
                self.state, self._values[0x603F] = OFF, 0
        elif not word & 0x02:  # disable voltage
            self.state = OFF
        elif not word & 0x04:  # quick stop
            self.state = _QUICK if self.state == RUN else self.state if self.state == _QUICK else OFF
        elif self.state == _QUICK:
            pass
        elif word & 0x0F == 0x06:
            self.state = _READY
        elif word & 0x0F == 0x07:
            if self.state in (_READY, RUN):
                self.state = _ON
        elif word & 0x0F == 0x0F and self.state in (_READY, _ON):
            self.state = RUN

    def _read(self, index: int | tuple[int, int]) -> int:
        if index == 0x6041:
            return self.state | _REMOTE | (self._zero.bits() if self._values[0x6060] == 6 else 0)
        if index == 0x2014:
            return self._zero.homed
        if index == 0x6061:
            return self._values[0x6060]
        if index == 0x6064:
            return round((self._y + _CENTRE_M + self._zero.off_m) * _UNITS)
        if index == 0x606C:
            return round(self._v * _UNITS)
        return self._values[index]

    def _write(self, index: int | tuple[int, int], value: int, now: float) -> int:
        if index == 0x6040:
            self._control(value)
            return 0
        if index == 0x6060 and value not in (3, 6):
            return 0x06090030
        if index == 0x60FF:
            self._coming.append((now + self._latency_s, value / _UNITS))
        self._values[index] = value
        return 0

    def answer(self, telegram: bytes, now: float) -> bytes:
        """Return the telegram that answers a request."""
        self._received = now
        head, pdu = telegram[:4], telegram[7:]

        def wrap(reply: bytes) -> bytes:
            return head + struct.pack(">HB", len(reply) + 1, 0) + reply

        def abort(code: int) -> bytes:
            return wrap(b"\xab\xff\x00\x06\x0d\xce" + code.to_bytes(4, "little"))

        if pdu[:1] != b"\x2b":
            return wrap(bytes([pdu[0] | 0x80, 1]))
        if len(pdu) < 12 or pdu[1] != 0x0D or pdu[2] > 1:
            return wrap(b"\xab\x03")
        number, sub, count, data = int.from_bytes(pdu[5:7], "big"), pdu[7], pdu[11], pdu[12:]
        index = (number, sub) if sub else number
        if index not in _OBJECTS:
            return abort(0x06020000)
        width, signed, writable = _OBJECTS[index]
        if count != width:
            return abort(0x06070010)
        if pdu[2] == 0:
            return wrap(pdu[:11] + bytes([width]) + self._read(index).to_bytes(width, "little", signed=signed))
        if not writable:
            return abort(0x06010002)
        if len(data) != width:
            return wrap(b"\xab\x03")
        refused = self._write(index, int.from_bytes(data, "little", signed=signed), now)
        return abort(refused) if refused else wrap(pdu[:11] + b"\0")


class Port:
    """TCP server of the drive: one master at a time, the newest."""

    def __init__(self, drive: Drive, host: str, port: int) -> None:
        self._drive = drive
        self._server = socket.create_server((host, port))
        self._server.setblocking(False)
        self._master: socket.socket | None = None
        self._buffer = b""

    def serve(self, now: float) -> None:
        """Accept a new master and answer its telegrams without waiting."""
        with contextlib.suppress(BlockingIOError):
            master, _ = self._server.accept()
            self._end()
            master.setblocking(False)
            master.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._master = master
        if self._master is None:
            return
        try:
            data = self._master.recv(4096)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        self._buffer += data
        if not self._process(self._master, now) or not data:
            self._end()

    def _process(self, master: socket.socket, now: float) -> bool:
        """Process all complete telegrams and return whether they were valid."""
        while len(self._buffer) >= 7:
            protocol, length = struct.unpack_from(">HH", self._buffer, 2)
            if protocol or not 3 <= length <= 64:
                return False
            if len(self._buffer) < 6 + length:
                return True
            telegram, self._buffer = self._buffer[: 6 + length], self._buffer[6 + length :]
            answer = self._drive.answer(telegram, now)
            with contextlib.suppress(OSError):  # a master that does not read still sends, at last a stop
                master.sendall(answer)
        return True

    def _end(self) -> None:
        self._buffer = b""
        if self._master is not None:
            self._master.close()
            self._master = None
            self._drive.hang_up()

    def close(self) -> None:
        """Stop listening for masters."""
        self._end()
        self._server.close()
