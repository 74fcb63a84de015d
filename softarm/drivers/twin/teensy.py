"""Teensy of the twin: the firmware's behaviour (`TeensyDevice`) behind a pseudo-terminal (`TeensyPort`)."""

import asyncio
import contextlib
import os
import secrets
import tty
from collections.abc import Callable
from pathlib import Path

from softarm.drivers.base import DeviceError
from softarm.drivers.regulator.cobs import DELIMITER, Deframer, frame
from softarm.drivers.regulator.teensy import (
    PRESSURE_RANGE_KPA,
    TIME_TO_LIVE_MAX_S,
    VENT_KPA,
    Fault,
    Hello,
    Message,
    RegulatorCommand,
    RegulatorState,
    Welcome,
    decode,
    encode,
    is_newer,
)
from softarm.drivers.twin.faults import Faults


class TeensyDevice:
    """Behaviour of the firmware. Pure: bytes and the time go in, bytes and a set-point come out.

    The device vents unless armed. Since the last hello, and since its commands last stopped, it must have received a
    disarmed and then an armed command with its token.
    """

    def __init__(self, new_token: Callable[[], int] = lambda: secrets.randbits(32)) -> None:
        self.armed = False
        self.faults = Fault(0)
        self.accepted_sequence = 0
        self._new_token = new_token
        self._token: int | None = None
        # Sequence of the last hello or accepted command.
        self._newest = 0
        self._may_arm = False
        self._set_point_kpa = VENT_KPA
        self._expires_ns = 0
        self._sequence = 0
        self._deframer = Deframer()

    @property
    def set_point_kpa(self) -> float:
        """Set-point of the regulator; zero unless armed."""
        return self._set_point_kpa if self.armed else VENT_KPA

    def watch(self, now_ns: int) -> None:
        """Vent when the last command's time to live has expired."""
        if self.armed and now_ns >= self._expires_ns:
            self.armed = self._may_arm = False
            self.faults |= Fault.TIME_TO_LIVE

    def receive(self, data: bytes, now_ns: int, pressure_kpa: float) -> bytes:
        """Return the answers to the messages that `data` completes, with the sensor's reading."""
        self.watch(now_ns)
        answers = b""
        for body in self._deframer.feed(data):
            # Noise is not answered.
            with contextlib.suppress(ValueError):
                message, sequence = decode(body)
                if isinstance(message, Hello):
                    answers += self._frame(self._welcome(sequence), now_ns)
                elif isinstance(message, RegulatorCommand):
                    self._execute(message, sequence, now_ns)
                    state = RegulatorState(self.accepted_sequence, self.armed, self.faults, pressure_kpa)
                    answers += self._frame(state, now_ns)
        return answers

    def _welcome(self, sequence: int) -> Welcome:
        self._token, self._newest, self.accepted_sequence = self._new_token(), sequence, 0
        self.armed = self._may_arm = False
        return Welcome(self._token)

    def _execute(self, command: RegulatorCommand, sequence: int, now_ns: int) -> None:
        self.faults &= ~(Fault.TOKEN | Fault.RANGE | Fault.SEQUENCE)
        low_kpa, high_kpa = PRESSURE_RANGE_KPA
        if command.token != self._token:
            self.faults |= Fault.TOKEN
        elif not is_newer(sequence, self._newest):
            self.faults |= Fault.SEQUENCE
        elif not (low_kpa <= command.pressure_kpa <= high_kpa and 0 < command.time_to_live_s <= TIME_TO_LIVE_MAX_S):
            self.faults |= Fault.RANGE
        else:
            self.accepted_sequence = self._newest = sequence
            self._expires_ns = now_ns + int(command.time_to_live_s * 1e9)
            self._set_point_kpa = command.pressure_kpa
            if not command.armed:
                self._may_arm = True
                self.faults &= ~Fault.TIME_TO_LIVE
            self.armed = command.armed and self._may_arm

    def _frame(self, message: Message, now_ns: int) -> bytes:
        self._sequence += 1
        return frame(encode(message, self._sequence, now_ns // 1000))


class TeensyPort:
    """Pseudo-terminal of a `TeensyDevice`, with a symbolic link at `path`."""

    def __init__(
        self,
        path: Path,
        device: TeensyDevice,
        faults: Faults,
        clock: Callable[[], int],
        pressure_kpa: Callable[[], float],
    ) -> None:
        self.device = device
        self._path, self._faults, self._clock, self._pressure_kpa = path, faults, clock, pressure_kpa
        self._ends: tuple[int, int] | None = None

    def open(self) -> None:
        """Plug the device in. Raises DeviceError if something other than a twin's link exists at `path`."""
        if self._ends is not None:
            return
        is_ours = self._path.is_symlink() and os.readlink(self._path).startswith("/dev/pts/")
        if os.path.lexists(self._path) and not is_ours:
            raise self._refusal("another file exists there")
        master, slave = os.openpty()
        # The slave stays open: without it the master would report hang-ups.
        for end in (master, slave):
            tty.setraw(end)
        os.set_blocking(master, False)
        self._ends = master, slave
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._path.unlink(missing_ok=True)
            self._path.symlink_to(os.ttyname(slave))
        except OSError as error:
            self.close()
            raise self._refusal(str(error)) from error
        asyncio.get_running_loop().add_reader(master, self._on_bytes)

    def close(self) -> None:
        """Unplug the device and remove the link."""
        if self._ends is None:
            return
        (master, slave), self._ends = self._ends, None
        asyncio.get_running_loop().remove_reader(master)
        if self._path.is_symlink() and os.readlink(self._path) == os.ttyname(slave):
            self._path.unlink()
        os.close(master)
        os.close(slave)

    def step(self) -> None:
        """Check the device's time to live, and plug or unplug it as the faults require."""
        self.device.watch(self._clock())
        if self._faults.active("serial_unplug"):
            self.close()
        else:
            self.open()

    def _on_bytes(self) -> None:
        if self._ends is None:
            return
        # The other end may be closed, or may not be read.
        with contextlib.suppress(OSError):
            data = os.read(self._ends[0], 4096)
            if not self._faults.active("serial_silence"):
                answer = self.device.receive(data, self._clock(), self._pressure_kpa())
                if self._faults.active("serial_garbage"):
                    frames = answer.split(DELIMITER)
                    answer = DELIMITER.join(bytes((f[0] ^ 0x10,)) + f[1:] if f else f for f in frames)
                os.write(self._ends[0], answer)

    def _refusal(self, problem: str) -> DeviceError:
        remedy = "set drivers.regulator.port to a path where the twin may create a link, e.g. /tmp/softarm-teensy"
        return DeviceError(str(self._path), "link the twin's serial port", problem, remedy)
