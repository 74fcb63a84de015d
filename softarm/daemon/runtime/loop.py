"""Control loop: runs the tick at 30 Hz between reading and writing the devices.

It owns the devices and shares only an inbox and immutable snapshots.
"""

import asyncio
import gc
import logging
import threading
import time
from collections.abc import Mapping

from softarm.common import realtime
from softarm.daemon.control.failsafe import Event
from softarm.daemon.control.inbox import Inbox
from softarm.daemon.control.records import EStop, Inputs, Mode, Outputs, Problems, TickTiming
from softarm.daemon.logbook.recorder import Recorder
from softarm.daemon.runtime.devices import Devices
from softarm.daemon.runtime.service import Notifier
from softarm.daemon.stop.latch import LatchKeeper
from softarm.daemon.tick import Controller
from softarm.policies import trusted
from softarm.policies.runner import PolicyRunner
from softarm.schemas.config import Config
from softarm.schemas.robot import CONTROL_RATE_HZ


class Rehearsal:
    """Rehearsal of the next tick, so that its code and data are in the processor's caches when it is due.

    After 30 ms of sleep the caches hold other data, and a tick takes three times as long as in a row. A second
    controller therefore repeats the previous tick. It shares no state with the first, and its outputs are discarded.
    A tick without a step of the policy is followed by one: a goal would start with a network last read minutes ago.
    """

    def __init__(self, config: Config, policy: PolicyRunner) -> None:
        self._policy = trusted.rehearsal(policy)
        self._controller: Controller | None = Controller(config, self._policy)

    def tick(self, inputs: Inputs, outputs: Outputs, runners: Mapping[int, PolicyRunner]) -> None:
        """Repeat a tick of the first controller. Never raises: after an error there are no more rehearsals."""
        if self._controller is None:
            return
        try:
            replicas = {number: trusted.rehearsal(each) for number, each in runners.items()}
            rehearsed = self._controller.tick(inputs, replicas)
            for result in rehearsed.results:
                if result.accepted and result.number in replicas:
                    self._policy = replicas[result.number]
            if rehearsed.action is None:
                trusted.read_weights(self._policy)
            self._controller.resume(outputs)
        except Exception:
            log.exception("a rehearsal of the control tick failed: ticks take longer from now on")
            self._controller = None


log = logging.getLogger(__name__)

PERIOD_NS = round(1e9 / CONTROL_RATE_HZ)
# Time between waking up and the deadline: a rehearsal, then a busy wait, so that core and caches stay awake.
# epoll rounds its time-out up to a whole millisecond, so that 2 to 3 ms are left.
AWAKE_NS = 3_000_000
REHEARSAL_NS = 1_000_000  # left before the deadline; otherwise there is no rehearsal
# Garbage is collected only if this much of the period is left.
COLLECT_SLACK_NS = 15_000_000
# Every so many collections is a full one; the others skip objects that survived two, such as a connection.
COLLECT_ALL_EVERY = 300


class ControlLoop:
    """Thread that runs the controller on absolute deadlines; a late tick skips whole periods."""

    def __init__(
        self,
        controller: Controller,
        devices: Devices,
        inbox: Inbox,
        recorder: Recorder,
        notifier: Notifier,
        latch: LatchKeeper | None = None,
        realtime_priority: int = 0,
        rehearsal: Rehearsal | None = None,
    ) -> None:
        self._controller = controller
        self._devices = devices
        self._inbox = inbox
        self._recorder = recorder
        self._notifier = notifier
        self._latch = latch
        self._priority = realtime_priority
        self._rehearsal = rehearsal
        self._previous: tuple[Inputs, Outputs, dict[int, PolicyRunner]] | None = None  # tick to be rehearsed
        self._thread = threading.Thread(target=self._main, name="control", daemon=True)
        self._stop = threading.Event()
        self._collections = 0
        self._failed: str | None = None  # exception of the controller; the arm stays stopped after it
        self._failed_ns = 0
        self.snapshot: Outputs | None = None
        self.problems = Problems()  # of the devices, in the newest tick

    def start(self) -> None:
        """Start the thread of the loop."""
        self._thread.start()

    def stop(self) -> None:
        """End the loop and leave every device safe, within a few seconds."""
        self._stop.set()
        self._thread.join(timeout=5.0)

    def _main(self) -> None:
        realtime.outrank_own_threads(self._priority)
        asyncio.run(self._run())

    async def _run(self) -> None:
        try:
            for device in self._devices.all():
                device.start()
            gc.collect()
            gc.freeze()
            gc.disable()  # collected explicitly in the idle part of a tick
            deadline = time.monotonic_ns() + PERIOD_NS
            while not self._stop.is_set():
                while (left := deadline - AWAKE_NS - time.monotonic_ns()) > 0:
                    await asyncio.sleep(left * 1e-9)
                self._rehearse(deadline)
                while time.monotonic_ns() < deadline:
                    await asyncio.sleep(0)
                deadline = self._tick(deadline)
        finally:
            gc.enable()
            await self._stop_devices()

    def _rehearse(self, deadline_ns: int) -> None:
        """Rehearse the tick unless time is short; requests are repeated in any case, since they change the state."""
        if self._rehearsal is None or self._previous is None:
            return
        if deadline_ns - time.monotonic_ns() > REHEARSAL_NS or self._previous[0].requests:
            self._rehearsal.tick(*self._previous)

    def _tick(self, deadline_ns: int) -> int:
        """Read, decide and write; return the next deadline."""
        now = time.monotonic_ns()
        late = now - deadline_ns
        missed = late // PERIOD_NS
        inputs, runners = self._read(now, late, missed)
        read = time.monotonic_ns()
        outputs = self._decide(inputs, runners)
        decided = time.monotonic_ns()
        self._write(outputs)
        written = time.monotonic_ns()
        newest = next((each.t_capture_ns for each in reversed(inputs.mocap) if each.t_capture_ns <= written), None)
        timing = TickTiming(read - now, decided - read, written - decided, written - newest if newest else None)
        self.snapshot, self.problems = outputs, inputs.problems
        self._previous = (inputs, outputs, runners) if self._failed is None else None
        if self._latch is not None:
            self._latch.note(None if outputs.estop is EStop.CLEAR else outputs.last_stop)
        for number, runner in runners.items():
            if any(result.number == number and result.accepted for result in outputs.results):
                gc.freeze()  # its objects live as long as the policy: no collection needs to visit them
                self._recorder.policy(runner.policy.spec)
        self._recorder.tick(inputs, outputs, timing)
        if self._failed is None and not missed:
            self._notifier.good_tick(written)
        following = deadline_ns + (missed + 1) * PERIOD_NS
        if following - time.monotonic_ns() > COLLECT_SLACK_NS:
            self._collections += 1
            gc.collect(2 if self._collections % COLLECT_ALL_EVERY == 0 else 1)
        return following

    def _read(self, now: int, late: int, missed: int) -> tuple[Inputs, dict[int, PolicyRunner]]:
        posts = self._inbox.take()
        devices = self._devices
        inputs = Inputs(
            t_ns=now,
            late_ns=late,
            missed=missed,
            mocap=devices.mocap.read(now),
            pressure=devices.regulator.read(),
            rail=devices.rail.read(),
            requests=tuple(post.request for post in posts),
            problems=Problems(devices.mocap.problem(), devices.regulator.problem(), devices.rail.problem()),
            recorder_dropped=self._recorder.dropped,
            recorder_problem=self._recorder.problem,
            latched=self._latch.left if self._latch is not None and self.snapshot is None else None,
            latch_problem=self._latch.problem if self._latch is not None else None,
        )
        return inputs, {p.request.number: p.runner for p in posts if p.runner is not None}

    def _decide(self, inputs: Inputs, runners: dict[int, PolicyRunner]) -> Outputs:
        if self._failed is None:
            try:
                return self._controller.tick(inputs, runners)
            except Exception as error:
                log.exception("the control loop failed: the arm is braked and vented; restart the service")
                self._failed, self._failed_ns = f"{type(error).__name__}: {error}", inputs.t_ns
        event = Event("internal_error", self._failed)
        return Outputs(
            t_ns=inputs.t_ns,
            tick=-1,
            late_ns=inputs.late_ns,
            missed=inputs.missed,
            missed_total=0,
            mode=Mode.STOPPED,
            estop=EStop.ENGAGED,
            events=(event.active(),),
            arming_refusals=(event.text,),
            last_stop=event.text,
            last_stop_ns=self._failed_ns,
        )

    def _write(self, outputs: Outputs) -> None:
        sent = outputs.sent
        self._devices.rail.write(sent.enable, sent.cart_velocity_m_s)
        self._devices.regulator.write(sent.enable, sent.pressure_kpa)
        if outputs.reset_devices:
            self._devices.rail.reset_fault()
            self._devices.regulator.reset_fault()

    async def _stop_devices(self) -> None:
        """Stop every device, even if another fails."""
        results = await asyncio.gather(*(d.stop() for d in self._devices.all()), return_exceptions=True)
        for result in results:
            if isinstance(result, BaseException):
                log.error("a device did not stop cleanly: %s", result)
