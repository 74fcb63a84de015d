"""Driver of the pressure regulator, a Teensy on a serial port.

A thread owns the port. It sends one command for each `write` and none by itself, so a dead control loop sends none.

State contract:

| state | entered when | the muscle | left when |
|---|---|---|---|
| closed | `start`, or the port was lost | vented by the device's time to live | the port opens |
| greeting | the port is open | vented: the device disarms on a hello | the device answers with its token |
| disarmed | the answer, or `write(False, ...)` | vented | `write(True, ...)` after a disarmed command |
| armed | that command | follows `write` | a disarmed command, the time to live, or a lost port |
| stopped | `stop` | vented: a last disarmed command is sent | never |

Without the host (process, computer or cable) the device vents when the last command's time to live has expired.
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

# USB CDC ignores the baud rate.
BAUD = 115200
# Between hellos until the device has answered one.
HELLO_S = 0.2
# Without an answer for so long: a problem is reported, and later the port is opened again.
SILENCE_S = 0.2
REOPEN_S = 1.0
# First and longest pause between attempts to open the port.
RETRY_S = (0.1, 0.5)
# Longest wait for the device to confirm that it vents.
VENT_S = 0.2

_REMEDY = {
    errno.ENOENT: "plug the Teensy in (ls /dev/serial/by-id), or correct drivers.regulator.port",
    errno.EACCES: "add the daemon's user to the group dialout",
    errno.EAGAIN: "another process holds the port: stop it",
}


class Conversation:
    """The host's half of one connection: bytes in, bytes out, no I/O.

    `state` is the device's newest answer, `dropped` counts the rejected frames, `complaint` is the reason for the last
    rejection. The device's own count must advance with each message, so a repeated message counts once.
    """

    def __init__(self, time_to_live_s: float) -> None:
        self.state: RegulatorState | None = None
        self.complaint: str | None = None
        self.unanswered_since_ns: int | None = None
        self._time_to_live_s = time_to_live_s
        self._token: int | None = None
        self._sequence = 0
        # Count of the device's newest message; a welcome restarts it.
        self._received: int | None = None
        self._greeted_ns: int | None = None
        self._deframer = Deframer()
        self._rejected = 0

    @property
    def dropped(self) -> int:
        """Number of frames that were garbled, repeated, or not a message of a device."""
        return self._deframer.dropped + self._rejected

    @property
    def known(self) -> bool:
        """Whether the device has sent its token."""
        return self._token is not None

    def greeting(self, now_ns: int) -> bytes:
        """Return a hello if one is due, else no bytes."""
        due = self._greeted_ns is None or now_ns - self._greeted_ns >= HELLO_S * 1e9
        if self.known or not due:
            return b""
        self._greeted_ns = now_ns
        return self._frame(Hello(), now_ns)

    def command(self, armed: bool, pressure_kpa: float, now_ns: int) -> bytes:
        """Return a command, or no bytes if the token is unknown."""
        if self._token is None:
            return b""
        return self._frame(RegulatorCommand(self._token, self._time_to_live_s, armed, pressure_kpa), now_ns)

    def receive(self, data: bytes) -> RegulatorState | None:
        """Return the newest state in `data`, or None."""
        newest = None
        for body in self._deframer.feed(data):
            try:
                message = self._accept(*decode(body))
            except ValueError as error:
                self._rejected += 1
                self.complaint = str(error)
                continue
            self.unanswered_since_ns = self.complaint = None
            if isinstance(message, RegulatorState):
                self.state = newest = message
        return newest

    def _accept(self, message: Message, sequence: int) -> Message:
        """Process a message of the device. Raises ValueError if it is not plausible now."""
        known, new = self.known, self._received is not None and is_newer(sequence, self._received)
        if isinstance(message, Welcome):
            self._token = message.token if new or not known else self._token
        elif not isinstance(message, RegulatorState):
            raise ValueError("the port echoes the sent bytes: it is not a regulator")
        elif known and Fault.TOKEN in message.faults:
            # The device has restarted: repeat the handshake.
            self._token = self._greeted_ns = None
        if not new and (known or isinstance(message, RegulatorState)):
            raise ValueError(f"the device's message {sequence} is repeated or late")
        self._received = sequence
        return message

    def _frame(self, message: Hello | RegulatorCommand, now_ns: int) -> bytes:
        if self.unanswered_since_ns is None:
            self.unanswered_since_ns = now_ns
        self._sequence += 1
        return frame(encode(message, self._sequence, now_ns // 1000))


def reading_of(state: RegulatorState, now_ns: int) -> PressureReading:
    """Return the reading for the control loop. A vent after the time to live is not a fault: it shows as disarmed."""
    return PressureReading(
        t_receive_ns=now_ns,
        pressure_kpa=state.pressure_kpa,
        armed=state.armed,
        faults=(state.faults & ~Fault.TIME_TO_LIVE).sentences(),
        sequence=state.accepted_sequence,
    )


class TeensyRegulator:
    """Driver of the regulator, a `softarm.drivers.base.PressureRegulator`; configured by `SerialRegulator`."""

    def __init__(self, config: SerialRegulator, clock: Callable[[], int] = time.monotonic_ns) -> None:
        self._config, self._clock = config, clock
        self._wakeup_receiver, self._wakeup_sender = socket.socketpair()
        self._wakeup_receiver.setblocking(False)
        self._wakeup_sender.setblocking(False)
        self._thread: threading.Thread | None = None
        self._stopping = False
        # The newest command replaces an older one.
        self._commands: deque[tuple[bool, float]] = deque(maxlen=1)
        self._reading: PressureReading | None = None
        self._conversation: Conversation | None = None
        self._link_problem = str(self._error("open", "not opened yet", "wait a second"))

    def start(self) -> None:
        """Open the port in a thread."""
        self._thread = threading.Thread(target=self._run, name="regulator", daemon=True)
        self._thread.start()

    async def stop(self) -> None:
        """Vent, wait for the device's confirmation (0.2 s at most), and free the port."""
        self._stopping = True
        self._wake()
        if self._thread is not None:
            await asyncio.to_thread(self._thread.join, 0.9)

    def read(self) -> PressureReading | None:
        """Return the newest reading, or None if none has arrived."""
        return self._reading

    def write(self, armed: bool, pressure_kpa: float) -> None:
        """Set the pressure until the next call. `armed=False`, NaN and infinity vent."""
        armed = armed and math.isfinite(pressure_kpa)
        self._commands.append((armed, pressure_kpa if armed else 0.0))
        self._wake()

    def reset_fault(self) -> None:
        """Do nothing: the device clears its faults with the next valid disarmed command."""

    def problem(self) -> str | None:
        """Return why there is no fresh reading, as one sentence with the next step, or None if all is well."""
        conversation = self._conversation
        if conversation is None:
            return self._link_problem
        since_ns = conversation.unanswered_since_ns
        silent_s = 0.0 if since_ns is None else (self._clock() - since_ns) / 1e9
        if conversation.complaint is not None:
            problem = f"{conversation.complaint} ({conversation.dropped} frames dropped)"
            return str(self._error("read", problem, "correct drivers.regulator.port, or update the firmware"))
        if silent_s > SILENCE_S:
            problem = f"no answer for {silent_s:.1f} s ({conversation.dropped} frames dropped)"
            return str(self._error("command", problem, "check the cable and that the firmware runs"))
        if not conversation.known:
            return str(self._error("hello", "no answer yet", "wait a second"))
        if conversation.state is not None and conversation.state.faults:
            return str(
                self._error("command", "the device reports a fault", "; ".join(conversation.state.faults.sentences()))
            )
        return None

    def _error(self, command: str, problem: str, remedy: str) -> DeviceError:
        return DeviceError(self._config.port, command, problem, remedy)

    def _wake(self) -> None:
        # A full socket means that the thread is awake, a closed one that it has ended.
        with contextlib.suppress(OSError):
            self._wakeup_sender.send(b"!")

    def _run(self) -> None:
        pause_s = RETRY_S[0]
        while not self._stopping:
            try:
                with self._open() as port:
                    pause_s = RETRY_S[0]
                    self._conversation = Conversation(self._config.time_to_live_s)
                    self._communicate(port, self._conversation)
            except DeviceError as error:
                self._link_problem = str(error)
            except (OSError, termios.error) as error:
                lost = self._error("communicate", f"the port was lost ({error})", "plug the device in again")
                self._link_problem = str(lost)
            self._conversation = None
            self._back_off(pause_s)
            pause_s = min(2 * pause_s, RETRY_S[1])
        self._wakeup_receiver.close()
        self._wakeup_sender.close()

    def _back_off(self, pause_s: float) -> None:
        until_s = time.monotonic() + pause_s
        while not self._stopping and (left_s := until_s - time.monotonic()) > 0:
            _wait(left_s, self._wakeup_receiver.fileno())
            self._drain_wakeup()
            # A command without a connection must not be sent later.
            self._commands.clear()

    def _open(self) -> serial.Serial:
        try:
            return serial.Serial(self._config.port, BAUD, timeout=0, exclusive=True)
        # A SerialException is an OSError.
        except (OSError, termios.error) as error:
            number = error.errno if isinstance(error, OSError) else None
            remedy = _REMEDY.get(number or 0, "set drivers.regulator.port to a serial port")
            raise self._error("open", str(error), remedy) from error

    def _communicate(self, port: serial.Serial, conversation: Conversation) -> None:
        while not self._stopping:
            _write(port, conversation.greeting(self._clock()))
            ready = _wait(HELLO_S, port.fileno(), self._wakeup_receiver.fileno())
            if self._wakeup_receiver.fileno() in ready:
                self._drain_wakeup()
                self._send_newest(port, conversation)
            if port.fileno() in ready:
                self._publish(conversation.receive(_read(port)))
            since_ns = conversation.unanswered_since_ns
            if since_ns is not None and self._clock() - since_ns > REOPEN_S * 1e9:
                remedy = "check the cable and that the firmware runs; the port is being opened again"
                raise self._error("command", f"no answer for {REOPEN_S:.0f} s", remedy)
        self._send_vent(port, conversation)

    def _send_newest(self, port: serial.Serial, conversation: Conversation) -> None:
        with contextlib.suppress(IndexError):
            armed, pressure_kpa = self._commands.popleft()
            _write(port, conversation.command(armed, pressure_kpa, self._clock()))

    def _publish(self, state: RegulatorState | None) -> None:
        if state is not None:
            self._reading = reading_of(state, self._clock())

    def _drain_wakeup(self) -> None:
        with contextlib.suppress(OSError):
            self._wakeup_receiver.recv(4096)

    def _send_vent(self, port: serial.Serial, conversation: Conversation) -> None:
        _write(port, conversation.command(False, 0.0, self._clock()))
        until_s = time.monotonic() + VENT_S
        while conversation.known and (left_s := until_s - time.monotonic()) > 0:
            if _wait(left_s, port.fileno()):
                state = conversation.receive(_read(port))
                self._publish(state)
                if state is not None and not state.armed:
                    return


# pyserial opens and configures the port. Its read and write use select, which fails above 1,024 descriptors.


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
        raise OSError(errno.EAGAIN, "the port accepts no more bytes: the device does not read")
