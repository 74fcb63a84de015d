"""Driver of the rail: an igus dryve D1, controlled by a process of its own (`process.py`, `master.py`).

This is the daemon's end: set-points go to that process over a pair of sockets, reports come back.

State contract:

| state | entered when | the drive | left when |
|---|---|---|---|
| connecting | `start`, or the connection failed | stopped first on every connection | mode and ramps are accepted |
| disabled | connected, or `write(False, ...)` after braking | out of operation | `write` turns from disable to enable |
| enabling | that turn | walks up the CiA 402 states at zero velocity | operation enabled, or a failure: disabled |
| operating | operation enabled | follows `write` | disable, fault, DI7 low, fall-back, not homed, time to live |
| replaced | the process ended, or was silent and killed | stopped first by the next process | a new report: disabled |
| stopped | `stop` | braked and disabled, or not reachable for 2 s | never |

Without the daemon (ended, frozen or delayed) the process brakes after `hold_s` without a set-point, disables the drive
after `time_to_live_s`, and disables it at once when the pair closes. Without the host (no power, no network) nothing in
software stops the drive: the hardware e-stop on DI7 and the regulator board's relay do (docs/operate/safety.md).
"""

import asyncio
import contextlib
import logging
import math
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import softarm
from softarm.drivers.base import DeviceError
from softarm.drivers.rail import pair, process
from softarm.drivers.rail.pair import Report, SetPoint
from softarm.drivers.rail.settings import Settings, settings_of
from softarm.schemas.config import DryveRail
from softarm.schemas.messages import RailReading

log = logging.getLogger(__name__)

# Without a report for so long while the drive may move, the process hangs.
SILENT_S = 0.15
# The same while the process starts or connects, and while the reserve takes over a drive that may move.
START_S = 5.0
TAKE_OVER_S = 0.5
# To brake, disable and disconnect, with new connections if necessary.
STOP_S = 2.2
# First and longest pause before a process is replaced that lived for less than `LIVED_S`.
RETRY_S = (0.05, 1.0)
LIVED_S = 5.0
# Between the start of a process and of its spare, and between looks at the spare.
SPARE_S = 1.0


class Process(NamedTuple):
    """The rail's process, and the daemon's end of its socket pair."""

    child: "subprocess.Popen[bytes]"
    line: socket.socket


Launch = Callable[[Settings, socket.socket, int], "subprocess.Popen[bytes]"]


def launch(settings: Settings, theirs: socket.socket, priority: int) -> "subprocess.Popen[bytes]":
    """Start the process with its end of the pair, in its own session, so that Ctrl-C does not reach it."""
    # Without site: the process needs nothing from it, and reading it takes longer than everything else.
    return subprocess.Popen(
        [sys.executable, "-S", "-P", "-m", process.__name__, *process.arguments(settings, priority)],
        stdin=theirs.fileno(),
        stdout=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": str(Path(softarm.__file__).parents[1])},
        start_new_session=True,
    )


class DryveRailAxis:
    """Driver of the rail, a `softarm.drivers.base.RailAxis`; configured by `softarm.schemas.config.DryveRail`.

    The drive is enabled only after `write` has turned from disable to enable, and again only after the next such turn:
    the replacement of a process never sets the cart in motion.
    """

    def __init__(
        self,
        config: DryveRail,
        realtime_priority: int = 0,
        clock: Callable[[], int] = time.monotonic_ns,
        launch: Launch = launch,
    ) -> None:
        """Prepare the driver; nothing starts yet.

        Args:
            config: Address and settings of the drive.
            realtime_priority: SCHED_FIFO priority of the control loop; the process gets one more. 0 leaves both alone.
            clock: Monotonic clock, ns.
            launch: Starts the process.
        """
        self._config, self._clock, self._launch = config, clock, launch
        self._priority = realtime_priority + 1 if realtime_priority else 0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._active: Process | None = None
        self._spare: Process | None = None
        self._was_spare = False  # the active process
        self._timer: asyncio.TimerHandle | None = None
        self._pause_s = RETRY_S[0]
        self._began_ns = self._received_ns = clock()
        self._number = self._acknowledged = 0
        self._reading: RailReading | None = None
        self._report: Report | None = None
        # Last known state of the drive.
        self._out_of_operation = True
        self._killed: str | None = None  # why this driver has killed the process
        self._loss = ""
        self._loss_unread = False
        self._ended = asyncio.Event()
        self._stopping = False
        self._reaping: set[asyncio.Task[None]] = set()

    def start(self) -> None:
        """Start the process, which connects by itself, and a spare."""
        self._loop = asyncio.get_running_loop()
        self._activate()
        self._ensure_spare()

    async def stop(self) -> None:
        """Close the pair, so that the process brakes, disables the drive and ends, and wait for it for `STOP_S`."""
        self._stopping = True
        if self._timer is not None:
            self._timer.cancel()
        # A process that hangs or dies is replaced once more.
        for _ in range(2):
            if self._active is None and not self._out_of_operation:
                self._activate()
            if (process := self._active) is None:
                break
            process.line.shutdown(socket.SHUT_WR)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(STOP_S):
                    await self._ended.wait()
                    await _reap(process.child)
                    # Disabled, or the drive could not be reached.
                    self._out_of_operation |= process.child.poll() == 0
            self._detach()
        if self._spare is not None:
            self._end(self._spare)
            self._spare = None
        await asyncio.gather(*self._reaping)

    def read(self) -> RailReading | None:
        """Return the newest reading, or None; the loss of a process shows in one reading at least."""
        self._loss_unread = False
        return self._reading

    def write(self, enable: bool, velocity_m_s: float) -> None:
        """Send a set-point to the process, and kill the process if it is silent. NaN and infinity count as zero."""
        if self._active is None:
            return
        now_ns, velocity_m_s = self._clock(), velocity_m_s if math.isfinite(velocity_m_s) else 0.0
        self._number = (self._number + 1) % 2**32
        set_point = SetPoint(self._number, now_ns, enable, velocity_m_s, self._acknowledged)
        # A process that has ended is noticed by `_receive`, one that hangs below.
        with contextlib.suppress(OSError):
            self._active.line.send(pair.encode_set_point(set_point))
        if self._is_silent():
            self._receive()  # after a delay of this loop reports are waiting
        if self._active is not None and self._is_silent():
            self._killed = f"it sent no report for {self._silent_max_s} s and was killed"
            self._active.child.kill()

    def reset_fault(self) -> None:
        """Request a fault reset. Only a drive in fault that is not requested to operate is reset."""
        self._acknowledged += 1

    def problem(self) -> str | None:
        """Return why there is no fresh reading, as one sentence with the next step, or None if all is well."""
        where = f"{self._config.host}:{self._config.port}"
        if self._reading is not None and not self._reading.linked:
            remedy = "a new process stops the drive first; read the service's log, then arm again"
            return str(DeviceError(where, "control the drive", f"the rail's process ended: {self._loss}", remedy))
        if self._report is None:
            return str(DeviceError(where, "connect", "not connected yet", "wait a second"))
        return self._report.problem

    # The process

    @property
    def _silent_max_s(self) -> float:
        if self._report is not None and not self._report.out_of_operation:
            return SILENT_S
        return TAKE_OVER_S if self._was_spare and not self._out_of_operation else START_S

    def _is_silent(self) -> bool:
        return self._clock() - self._received_ns > self._silent_max_s * 1e9

    def _start_process(self) -> Process | None:
        """Return a new process, or None if the system refuses it now."""
        try:
            ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            ours.setblocking(False)
            with theirs:
                try:
                    return Process(self._launch(settings_of(self._config), theirs, self._priority), ours)
                except OSError:
                    ours.close()
                    raise
        except OSError as error:
            log.error("the rail's process cannot be started (%s); trying again", error)
            return None

    def _activate(self) -> None:
        """Let the spare, or else a new process, control the drive; try again if there is none."""
        assert self._loop is not None
        spare = self._take_spare()
        self._was_spare = spare is not None
        self._active = spare or self._start_process()
        if self._active is None:
            self._retry()
            return
        self._ended.clear()
        self._began_ns = self._received_ns = self._clock()
        with contextlib.suppress(OSError):
            self._active.line.send(pair.encode_begin(not self._out_of_operation))
        self._loop.add_reader(self._active.line, self._receive)
        self._after(SPARE_S, self._ensure_spare)

    def _retry(self) -> None:
        self._after(self._pause_s, self._activate)
        self._pause_s = min(2 * self._pause_s, RETRY_S[1])

    def _after(self, pause_s: float, action: Callable[[], None]) -> None:
        """Run an action later instead of the one that was planned; none while this driver stops."""
        if self._timer is not None:
            self._timer.cancel()
        if self._loop is not None and not self._stopping:
            self._timer = self._loop.call_later(pause_s, action)

    def _ensure_spare(self) -> None:
        """Start a spare unless one lives, and look again later; without an active process the spare is activated."""
        self._spare = self._take_spare() or self._start_process()
        if self._active is None and self._spare is not None:
            self._activate()
        else:
            self._after(SPARE_S, self._ensure_spare)

    def _take_spare(self) -> Process | None:
        """Return the spare if it lives, and keep none."""
        spare, self._spare = self._spare, None
        if spare is not None and spare.child.poll() is not None:
            self._end(spare)
            return None
        return spare

    def _receive(self) -> None:
        """Accept all waiting reports, or replace a process that has ended."""
        while self._active is not None:
            try:
                packet = self._active.line.recv(pair.PACKET_MAX)
            except BlockingIOError:
                return
            except OSError:
                packet = b""
            if packet:
                self._accept(pair.decode_report(packet))
            elif self._stopping:
                assert self._loop is not None
                self._loop.remove_reader(self._active.line)
                self._ended.set()
                return
            else:
                self._replace()

    def _accept(self, report: Report) -> None:
        known, found = self._report.reading if self._report is not None else None, report.reading
        self._report, self._received_ns, self._out_of_operation = report, self._clock(), report.out_of_operation
        if found is not None and found != known and not self._loss_unread:
            fields = found._asdict()
            self._reading = RailReading(t_receive_ns=fields.pop("t_ns"), **fields)

    def _replace(self) -> None:
        """Detach from a process that has ended and activate another."""
        self._detach()
        self._loss, self._killed = self._killed or "by itself", None
        log.error("the rail's process ended (%s); a new one stops the drive first", self._loss)
        if self._reading is not None:
            self._reading, self._loss_unread = replace(self._reading, enabled=False, linked=False), True
        if self._clock() - self._began_ns > LIVED_S * 1e9 or self._spare is not None:
            self._pause_s = RETRY_S[0]
            self._activate()
        else:
            self._retry()

    def _detach(self) -> None:
        """Detach from the active process and reap it."""
        process, self._active, self._report = self._active, None, None
        if process is not None and self._loop is not None:
            self._loop.remove_reader(process.line)
            self._end(process)

    def _end(self, process: Process) -> None:
        process.line.close()
        process.child.kill()
        assert self._loop is not None
        task = self._loop.create_task(_reap(process.child))
        self._reaping.add(task)
        task.add_done_callback(self._reaping.discard)


async def _reap(child: "subprocess.Popen[bytes]") -> None:
    while child.poll() is None:
        await asyncio.sleep(0.005)
