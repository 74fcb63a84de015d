"""The rail: an igus dryve D1, led by a process of its own so that the daemon's death, freeze or stall stops the cart.

Here is the daemon's end: set-points go to that process (`process.py`, `master.py`) over a pair of sockets, reports come
back. When it ends another takes its place, which is kept ready and stops the drive first; when it falls silent it is
ended.
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
from typing import NamedTuple, Protocol

import softarm
from softarm.drivers.base import DeviceError
from softarm.drivers.rail import pair, process
from softarm.drivers.rail.pair import Report, SetPoint
from softarm.drivers.rail.settings import Settings, settings_of
from softarm.schemas.config import DryveRail
from softarm.schemas.messages import RailReading

log = logging.getLogger(__name__)

SILENT_S = 0.15  # without a report for so long while the drive may move, the process hangs
START_S = 5.0  # the same while it starts, or tries to find a drive that is off
STOP_S = 2.2  # to brake, switch off and hang up, over new connections too if need be
RETRY_S = (0.05, 1.0)  # first and longest pause before a process is replaced that did not live for `LIVED_S`
LIVED_S = 5.0
SPARE_S = 1.0  # after a process has begun, another is made ready


class Child(Protocol):
    """What is asked of a process: a part of `subprocess.Popen`."""

    def poll(self) -> int | None:
        """Its exit code; None while it lives."""

    def kill(self) -> None:
        """End it, whatever it does."""


class Process(NamedTuple):
    """One, and our end of the pair."""

    child: Child
    line: socket.socket


Launch = Callable[[Settings, socket.socket, int], Child]


def launch(settings: Settings, theirs: socket.socket, priority: int) -> Child:
    """Start the process with its end of the pair. In a session of its own: Ctrl-C is not for it."""
    return subprocess.Popen(
        # Without site: nothing is needed from there, and reading it takes longer than all else.
        [sys.executable, "-S", "-P", "-m", process.__name__, *process.arguments(settings, priority)],
        stdin=theirs.fileno(),
        stdout=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": str(Path(softarm.__file__).parents[1])},
        start_new_session=True,
    )


class DryveRailAxis:
    """A `softarm.drivers.base.RailAxis`; configured by `softarm.schemas.config.DryveRail`.

    The drive is switched on only after `write` has turned from disable to enable, and again only after the next such
    turn: no process that is replaced sets the cart in motion.
    """

    def __init__(
        self,
        config: DryveRail,
        realtime_priority: int = 0,
        clock: Callable[[], int] = time.monotonic_ns,
        launch: Launch = launch,
    ) -> None:
        """`realtime_priority`: of the control loop; the process is put above it. 0: not at all."""
        self._config, self._clock, self._launch = config, clock, launch
        self._priority = realtime_priority + 1 if realtime_priority else 0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._leading: Process | None = None
        self._spare: Process | None = None
        self._later: asyncio.TimerHandle | None = None
        self._pause_s = RETRY_S[0]
        self._began_ns = self._heard_ns = clock()
        self._number = self._acknowledged = 0
        self._reading: RailReading | None = None
        self._report: Report | None = None  # of the present process
        self._at_ease = True  # the drive, as far as we know
        self._lost: str | None = None  # why the process before this one ended
        self._loss_untold = False  # `read` has to show it once
        self._ended = asyncio.Event()
        self._stopping = False
        self._burials: list[asyncio.Task[None]] = []

    def start(self) -> None:
        """Start the process, which connects by itself, and the one in reserve."""
        self._loop = asyncio.get_running_loop()
        self._begin()
        self._make_ready()

    async def stop(self) -> None:
        """Hang up, which makes the process brake, switch the drive off and end; waits for that for `STOP_S`."""
        self._stopping = True
        if self._later is not None:
            self._later.cancel()
        for _ in range(2):  # one that hangs is replaced once more
            if self._leading is None and not self._at_ease:
                self._begin()
            if self._leading is None:
                break
            self._leading.line.shutdown(socket.SHUT_WR)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(STOP_S):
                    await self._ended.wait()
                    self._at_ease = True  # or it could not be reached
            self._part()
        if self._spare is not None:
            self._bury(self._spare)
            self._spare = None
        await asyncio.gather(*self._burials)

    def read(self) -> RailReading | None:
        """See `softarm.drivers.base.RailAxis.read`."""
        self._loss_untold = False
        return self._reading

    def write(self, enable: bool, velocity_m_s: float) -> None:
        """See `softarm.drivers.base.RailAxis.write`; from the loop's own thread. A velocity of NaN is zero."""
        if self._leading is None:
            return
        now_ns, velocity_m_s = self._clock(), velocity_m_s if math.isfinite(velocity_m_s) else 0.0
        self._number = (self._number + 1) % 2**32
        set_point = SetPoint(self._number, now_ns, enable, velocity_m_s, self._acknowledged)
        with contextlib.suppress(OSError):  # it has ended, which is heard, or hangs, which is seen here
            self._leading.line.send(pair.encode_set_point(set_point))
        moving = self._report is not None and not self._report.at_ease
        patience_s = SILENT_S if moving else START_S
        if now_ns - self._heard_ns > patience_s * 1e9:
            self._lost = f"it was silent for {patience_s} s and was killed"
            self._leading.child.kill()

    def reset_fault(self) -> None:
        """See `softarm.drivers.base.Device.reset_fault`; only a drive in fault, and while disabled, is reset."""
        self._acknowledged += 1

    def problem(self) -> str | None:
        """See `softarm.drivers.base.Device.problem`."""
        where = f"{self._config.host}:{self._config.port}"
        if self._reading is not None and not self._reading.linked:
            remedy = "another stops the drive first; look at the service's log, then arm again"
            return str(DeviceError(where, "lead the drive", f"the rail's process ended: {self._lost}", remedy))
        if self._report is None:
            return str(DeviceError(where, "connect", "not connected yet", "wait a second"))
        return self._report.problem

    # The process

    def _start(self) -> Process:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.setblocking(False)
        with theirs:
            return Process(self._launch(settings_of(self._config), theirs, self._priority), ours)

    def _begin(self) -> None:
        """Have a process lead the drive: the one in reserve, if there is one."""
        assert self._loop is not None
        self._leading, self._spare = self._spare or self._start(), None
        self._began_ns = self._heard_ns = self._clock()
        with contextlib.suppress(OSError):  # its end is heard
            self._leading.line.send(pair.encode_begin(not self._at_ease))
        self._loop.add_reader(self._leading.line, self._hear)
        self._later = self._loop.call_later(SPARE_S, self._make_ready)

    def _make_ready(self) -> None:
        """Keep one in reserve."""
        self._spare = self._spare or self._start()

    def _hear(self) -> None:
        """All that the process has reported; or its end."""
        while self._leading is not None:
            try:
                packet = self._leading.line.recv(pair.PACKET_MAX)
            except BlockingIOError:
                return
            except OSError:
                packet = b""
            if packet:
                self._take(pair.decode_report(packet))
            else:
                self._replace()

    def _take(self, report: Report) -> None:
        known, found = self._report.reading if self._report is not None else None, report.reading
        self._report, self._heard_ns, self._at_ease = report, self._clock(), report.at_ease
        if found is not None and found != known and not self._loss_untold:
            self._reading = RailReading(
                t_receive_ns=found.t_ns,
                position_m=found.position_m,
                velocity_m_s=found.velocity_m_s,
                enabled=found.enabled,
                remote=found.remote,
                faults=found.faults,
                cycle_p50_ns=found.cycle_p50_ns,
                cycle_max_ns=found.cycle_max_ns,
                homed=found.homed,
            )

    def _replace(self) -> None:
        """The process has ended: have another lead the drive, unless that was asked for."""
        self._part()
        self._ended.set()
        if self._stopping or self._loop is None:
            return
        self._lost = self._lost or "by itself"
        log.error("the rail's process ended (%s): another stops the drive first", self._lost)
        if self._reading is not None:
            self._reading, self._loss_untold = replace(self._reading, enabled=False, linked=False), True
        if self._later is not None:
            self._later.cancel()
        if self._clock() - self._began_ns > LIVED_S * 1e9 or self._spare is not None:
            self._pause_s = RETRY_S[0]
            self._begin()
        else:
            self._later = self._loop.call_later(self._pause_s, self._begin)
            self._pause_s = min(2 * self._pause_s, RETRY_S[1])

    def _part(self) -> None:
        """From the process as from one that has ended, or will never."""
        process, self._leading, self._report = self._leading, None, None
        if process is not None and self._loop is not None:
            self._loop.remove_reader(process.line)
            self._bury(process)

    def _bury(self, process: Process) -> None:
        process.line.close()
        process.child.kill()
        assert self._loop is not None
        self._burials.append(self._loop.create_task(_reap(process.child)))


async def _reap(child: Child) -> None:
    while child.poll() is None:
        await asyncio.sleep(0.005)
