"""The twin's Teensy: what the firmware does (`TeensyDevice`), behind a pseudo-terminal (`TeensyPort`)."""

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
    """Pure: bytes and the time go in, bytes and a set-point come out.

    It vents unless armed. To be armed it must have heard, since the last hello and since the last time its
    commands stopped, first a disarmed and then an armed command with the token that it gave out.
    """

    def __init__(self, new_token: Callable[[], int] = lambda: secrets.randbits(32)) -> None:
        self.armed = False
        self.faults = Fault(0)
        self.accepted_sequence = 0
        self._new_token = new_token
        self._token: int | None = None
        self._newest = 0  # the sequence of the last hello or accepted command
        self._may_arm = False
        self._set_point_kpa = VENT_KPA
        self._expires_ns = 0
        self._sequence = 0
        self._deframer = Deframer()

    @property
    def set_point_kpa(self) -> float:
        """What the regulator is told."""
        return self._set_point_kpa if self.armed else VENT_KPA

    def watch(self, now_ns: int) -> None:
        """Vent when the last command's time to live has run out."""
        if self.armed and now_ns >= self._expires_ns:
            self.armed = self._may_arm = False
            self.faults |= Fault.TIME_TO_LIVE

    def receive(self, data: bytes, now_ns: int, pressure_kpa: float) -> bytes:
        """The answers to what `data` completes; `pressure_kpa` is what the sensor reads."""
        self.watch(now_ns)
        answers = b""
        for body in self._deframer.feed(data):
            with contextlib.suppress(ValueError):  # not for us; silence is the answer to noise
                message, sequence = decode(body)
                if isinstance(message, Hello):
                    answers += self._frame(self._greet(sequence), now_ns)
                elif isinstance(message, RegulatorCommand):
                    self._obey(message, sequence, now_ns)
                    state = RegulatorState(self.accepted_sequence, self.armed, self.faults, pressure_kpa)
                    answers += self._frame(state, now_ns)
        return answers

    def _greet(self, sequence: int) -> Welcome:
        self._token, self._newest, self.accepted_sequence = self._new_token(), sequence, 0
        self.armed = self._may_arm = False
        return Welcome(self._token)

    def _obey(self, command: RegulatorCommand, sequence: int, now_ns: int) -> None:
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
    """Puts a `TeensyDevice` behind a pseudo-terminal; a symbolic link at `path` leads there."""

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
        """Plug the device in. Raises DeviceError when something that is no twin's link is at `path`."""
        if self._ends is not None:
            return
        if os.path.lexists(self._path) and not _leads_to_terminal(self._path):
            raise self._refusal("something else is there")
        master, slave = os.openpty()
        for end in (master, slave):  # the slave stays open: without a reader the master would report hang-ups
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
        """Unplug it."""
        if self._ends is None:
            return
        (master, slave), self._ends = self._ends, None
        asyncio.get_running_loop().remove_reader(master)
        if self._path.is_symlink() and os.readlink(self._path) == os.ttyname(slave):
            self._path.unlink()
        os.close(master)
        os.close(slave)

    def step(self) -> None:
        """Let the device look at its clock, and the plug at its fault."""
        self.device.watch(self._clock())
        if self._faults.active("serial_unplug"):
            self.close()
        else:
            self.open()

    def _on_bytes(self) -> None:
        if self._ends is None:
            return
        with contextlib.suppress(OSError):  # nobody has the other end open, or nobody reads there
            data = os.read(self._ends[0], 4096)
            if not self._faults.active("serial_silence"):
                answer = self.device.receive(data, self._clock(), self._pressure_kpa())
                if self._faults.active("serial_garbage"):
                    frames = answer.split(DELIMITER)
                    answer = DELIMITER.join(bytes((f[0] ^ 0x10,)) + f[1:] if f else f for f in frames)
                os.write(self._ends[0], answer)

    def _refusal(self, problem: str) -> DeviceError:
        remedy = "set drivers.regulator.port to a path where the twin may make a link, e.g. /tmp/softarm-teensy"
        return DeviceError(str(self._path), "link the twin's serial port", problem, remedy)


def _leads_to_terminal(path: Path) -> bool:
    return path.is_symlink() and os.readlink(path).startswith("/dev/pts/")
