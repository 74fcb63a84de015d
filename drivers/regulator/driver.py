"""The pressure regulator behind a Teensy on a serial port.

A thread owns the port. It sends one command for each `write` and nothing of its own accord: when the control
loop dies, commands stop, and the device vents.
"""

import asyncio
import contextlib
import errno
import math
import os
import select
import socket
import termios
import threading
import time
from collections import deque
from collections.abc import Callable

import serial

from softarm.drivers.base import DeviceError
from softarm.drivers.regulator.cobs import Deframer, frame
from softarm.drivers.regulator.teensy import (
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
from softarm.schemas.config import SerialRegulator
from softarm.schemas.messages import PressureReading

BAUD = 115200  # USB CDC ignores it
HELLO_S = 0.2  # between greetings until the device has answered one
SILENCE_S = 0.2  # without an answer to what we send: a problem
REOPEN_S = 1.0  # without an answer: the port is opened anew
RETRY_S = (0.1, 0.5)  # first and longest pause between attempts to open
FAREWELL_S = 0.2  # waited for the device's word that it vents

_REMEDY = {
    errno.ENOENT: "plug the Teensy in (ls /dev/serial/by-id), or correct drivers.regulator.port",
    errno.EACCES: "add the daemon's user to the group dialout",
    errno.EAGAIN: "another process holds the port: stop it",
}


class Conversation:
    """The host's half of one opening of the port: bytes in, bytes out, no I/O.

    `state` is the device's newest answer, `dropped` counts frames that were no new message of the device,
    `complaint` says why the last of them was not. What the device says counts once: its own count must advance.
    """

    def __init__(self, time_to_live_s: float) -> None:
        self.state: RegulatorState | None = None
        self.complaint: str | None = None
        self.unanswered_since_ns: int | None = None
        self._time_to_live_s = time_to_live_s
        self._token: int | None = None
        self._sequence = 0
        self._heard: int | None = None  # the device's own count; it begins anew with a welcome
        self._greeted_ns: int | None = None
        self._deframer = Deframer()
        self._refused = 0

    @property
    def dropped(self) -> int:
        """Frames that were garbled, no message that a device sends, or one that was heard before."""
        return self._deframer.dropped + self._refused

    @property
    def known(self) -> bool:
        """Whether the device has told its token."""
        return self._token is not None

    def greeting(self, now_ns: int) -> bytes:
        """A hello when one is due, else nothing."""
        due = self._greeted_ns is None or now_ns - self._greeted_ns >= HELLO_S * 1e9
        if self.known or not due:
            return b""
        self._greeted_ns = now_ns
        return self._frame(Hello(), now_ns)

    def command(self, armed: bool, pressure_kpa: float, now_ns: int) -> bytes:
        """A set-point; nothing before the device has told its token."""
        if self._token is None:
            return b""
        return self._frame(RegulatorCommand(self._token, self._time_to_live_s, armed, pressure_kpa), now_ns)

    def receive(self, data: bytes) -> RegulatorState | None:
        """The newest state in `data`, if one came."""
        newest = None
        for body in self._deframer.feed(data):
            try:
                message = self._heed(*decode(body))
            except ValueError as error:
                self._refused += 1
                self.complaint = str(error)
                continue
            self.unanswered_since_ns = self.complaint = None
            if isinstance(message, RegulatorState):
                self.state = newest = message
        return newest

    def _heed(self, message: Message, sequence: int) -> Message:
        """Take in what the device says. Raises ValueError on what it cannot be saying now."""
        known, new = self.known, self._heard is not None and is_newer(sequence, self._heard)
        if isinstance(message, Welcome):
            self._token = message.token if new or not known else self._token
        elif not isinstance(message, RegulatorState):
            raise ValueError("the port echoes what is sent: is it a device at all?")
        elif known and Fault.TOKEN in message.faults:
            self._token = self._greeted_ns = None  # the device has restarted: greet it again, whatever its count
        if not new and (known or isinstance(message, RegulatorState)):
            raise ValueError(f"the device's message {sequence} is not newer than the last: repeated, or late")
        self._heard = sequence
        return message

    def _frame(self, message: Hello | RegulatorCommand, now_ns: int) -> bytes:
        if self.unanswered_since_ns is None:
            self.unanswered_since_ns = now_ns
        self._sequence += 1
        return frame(encode(message, self._sequence, now_ns // 1000))


def reading_of(state: RegulatorState, now_ns: int) -> PressureReading:
    """What the control loop hears. A vent by time to live is no fault of the device: it is armed no longer."""
    return PressureReading(
        t_receive_ns=now_ns,
        pressure_kpa=state.pressure_kpa,
        armed=state.armed,
        faults=(state.faults & ~Fault.TIME_TO_LIVE).sentences(),
        sequence=state.accepted_sequence,
    )


class TeensyRegulator:
    """A `softarm.drivers.base.PressureRegulator`; configured by `softarm.schemas.config.SerialRegulator`."""

    def __init__(self, config: SerialRegulator, clock: Callable[[], int] = time.monotonic_ns) -> None:
        self._config, self._clock = config, clock
        self._bell, self._ringer = socket.socketpair()
        self._bell.setblocking(False)
        self._ringer.setblocking(False)
        self._thread: threading.Thread | None = None
        self._stopping = False
        self._wanted: deque[tuple[bool, float]] = deque(maxlen=1)  # newest wins
        self._reading: PressureReading | None = None
        self._talk: Conversation | None = None
        self._link_problem = str(self._error("open", "not opened yet", "wait a second"))

    def start(self) -> None:
        """Open the port in a thread of its own."""
        self._thread = threading.Thread(target=self._run, name="regulator", daemon=True)
        self._thread.start()

    async def stop(self) -> None:
        """Vent, wait for the device's word (0.2 s at most), and free the port."""
        self._stopping = True
        self._ring()
        if self._thread is not None:
            await asyncio.to_thread(self._thread.join, 0.9)

    def read(self) -> PressureReading | None:
        """See `softarm.drivers.base.PressureRegulator.read`."""
        return self._reading

    def write(self, armed: bool, pressure_kpa: float) -> None:
        """See `softarm.drivers.base.PressureRegulator.write`. A set-point that is not finite vents."""
        armed = armed and math.isfinite(pressure_kpa)
        self._wanted.append((armed, pressure_kpa if armed else 0.0))
        self._ring()

    def reset_fault(self) -> None:
        """The device clears its faults by itself, on the next good disarmed command."""

    def problem(self) -> str | None:
        """See `softarm.drivers.base.Device.problem`."""
        talk = self._talk
        if talk is None:
            return self._link_problem
        since_ns = talk.unanswered_since_ns
        silent_s = 0.0 if since_ns is None else (self._clock() - since_ns) / 1e9
        if talk.complaint is not None:
            heard = f"{talk.complaint} ({talk.dropped} frames dropped)"
            return str(self._error("read", heard, "correct drivers.regulator.port, or update the firmware"))
        if silent_s > SILENCE_S:
            heard = f"no answer for {silent_s:.1f} s ({talk.dropped} frames dropped)"
            return str(self._error("command", heard, "check the cable and that the firmware runs"))
        if not talk.known:
            return str(self._error("hello", "no answer yet", "wait a second"))
        if talk.state is not None and talk.state.faults:
            return str(self._error("command", "the device reports a fault", "; ".join(talk.state.faults.sentences())))
        return None

    def _error(self, command: str, problem: str, remedy: str) -> DeviceError:
        return DeviceError(self._config.port, command, problem, remedy)

    def _ring(self) -> None:
        with contextlib.suppress(OSError):  # full: the thread is awake already; closed: it has ended
            self._ringer.send(b"!")

    def _run(self) -> None:
        pause_s = RETRY_S[0]
        while not self._stopping:
            try:
                with self._open() as port:
                    pause_s = RETRY_S[0]
                    self._talk = Conversation(self._config.time_to_live_s)
                    self._converse(port, self._talk)
            except DeviceError as error:
                self._link_problem = str(error)
            except (OSError, termios.error) as error:
                lost = self._error("converse", f"the port was lost ({error})", "plug the device in again")
                self._link_problem = str(lost)
            self._talk = None
            self._rest(pause_s)
            pause_s = min(2 * pause_s, RETRY_S[1])
        self._bell.close()
        self._ringer.close()

    def _rest(self, pause_s: float) -> None:
        until_s = time.monotonic() + pause_s
        while not self._stopping and (left_s := until_s - time.monotonic()) > 0:
            _wait(left_s, self._bell.fileno())
            self._hush()
            self._wanted.clear()  # said to nobody; what is old must not be sent later

    def _open(self) -> serial.Serial:
        try:
            return serial.Serial(self._config.port, BAUD, timeout=0, exclusive=True)
        except (OSError, termios.error) as error:  # a SerialException is an OSError
            number = error.errno if isinstance(error, OSError) else None
            remedy = _REMEDY.get(number or 0, "is it a serial port? Correct drivers.regulator.port")
            raise self._error("open", str(error), remedy) from error

    def _converse(self, port: serial.Serial, talk: Conversation) -> None:
        while not self._stopping:
            _write(port, talk.greeting(self._clock()))
            ready = _wait(HELLO_S, port.fileno(), self._bell.fileno())
            if self._bell.fileno() in ready:
                self._hush()
                self._send_newest(port, talk)
            if port.fileno() in ready:
                self._take(talk.receive(_read(port)))
            since_ns = talk.unanswered_since_ns
            if since_ns is not None and self._clock() - since_ns > REOPEN_S * 1e9:
                remedy = "check the cable and that the firmware runs; the port is opened anew"
                raise self._error("command", f"no answer for {REOPEN_S:.0f} s", remedy)
        self._say_farewell(port, talk)

    def _send_newest(self, port: serial.Serial, talk: Conversation) -> None:
        with contextlib.suppress(IndexError):
            armed, pressure_kpa = self._wanted.popleft()
            _write(port, talk.command(armed, pressure_kpa, self._clock()))

    def _take(self, state: RegulatorState | None) -> None:
        if state is not None:
            self._reading = reading_of(state, self._clock())

    def _hush(self) -> None:
        with contextlib.suppress(OSError):
            self._bell.recv(4096)

    def _say_farewell(self, port: serial.Serial, talk: Conversation) -> None:
        _write(port, talk.command(False, 0.0, self._clock()))
        until_s = time.monotonic() + FAREWELL_S
        while talk.known and (left_s := until_s - time.monotonic()) > 0:
            if _wait(left_s, port.fileno()):
                state = talk.receive(_read(port))
                self._take(state)
                if state is not None and not state.armed:
                    return


# pyserial opens the port and sets it up; its read and write end above 1,024 descriptors, for they use select.


def _wait(timeout_s: float, *descriptors: int) -> set[int]:
    poll = select.poll()
    for descriptor in descriptors:
        poll.register(descriptor, select.POLLIN)
    return {descriptor for descriptor, _ in poll.poll(timeout_s * 1e3)}


def _read(port: serial.Serial) -> bytes:
    data = os.read(port.fileno(), 4096)
    if not data:
        raise OSError(errno.EIO, "end of file: the device is gone")
    return data


def _write(port: serial.Serial, data: bytes) -> None:
    if os.write(port.fileno(), data) < len(data):
        raise OSError(errno.EAGAIN, "the port takes no more: nobody reads at its other end")
