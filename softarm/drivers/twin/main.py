"""Process of the twin: a body behind three ports, advanced in real time."""

import asyncio
import contextlib
import gc
import signal
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Self

from softarm.drivers.bodies.base import Body
from softarm.drivers.bodies.simulated import SimulatedBody
from softarm.drivers.regulator.teensy import VENT_KPA
from softarm.drivers.twin.cameras import Cameras, TwinState
from softarm.drivers.twin.dryve import LIMIT_SWITCH, DryveDevice, DryveServer
from softarm.drivers.twin.faults import Faults
from softarm.drivers.twin.teensy import TeensyDevice, TeensyPort
from softarm.schemas.config import Config

FRAME_HZ = 120
# Frames for each published state: 30 Hz.
STATE_EVERY = 4
# A swinging arm drags a braked cart at less than this velocity.
BRAKED_M_S = 0.05
# A cart this close to an end of the travel touches it.
TOUCH_M = 0.0005
DELAY_MAX_NS = 25_000_000
# After a longer delay the twin skips the missed time.
CATCH_UP_FRAMES = 30


class DeviceClock:
    """Clock of the devices' watchdogs: delays of the twin's own process do not count as silence of the host."""

    def __init__(self, clock: Callable[[], int]) -> None:
        self._clock = clock
        self._real_ns = self._own_ns = clock()

    def __call__(self) -> int:
        """Return the time in nanoseconds."""
        return self._own_ns + min(self._clock() - self._real_ns, DELAY_MAX_NS)

    def step(self) -> None:
        """Follow real time. Call it much more often than every `DELAY_MAX_NS`."""
        self._own_ns, self._real_ns = self(), self._clock()


class Since:
    """Time since which a condition has been true."""

    def __init__(self) -> None:
        self.t_ns: int | None = None

    def update(self, is_true: bool, now_ns: int) -> int | None:
        """Return the time since which the condition is true, or None while it is false."""
        self.t_ns = (self.t_ns or now_ns) if is_true else None
        return self.t_ns


class EndStops:
    """Counter of the cart's crashes into the ends of its travel; staying at an end counts once.

    `cart_max_abs_m` is the largest distance from the middle so far.
    """

    def __init__(self, travel_m: float) -> None:
        self.crashes = 0
        self.cart_max_abs_m = 0.0
        self._travel_m = travel_m
        self._there = False

    def update(self, cart_position_m: float) -> bool:
        """Return whether the cart has just reached an end."""
        distance_m = abs(cart_position_m)
        self.cart_max_abs_m = max(self.cart_max_abs_m, min(distance_m, self._travel_m))
        before, self._there = self._there, distance_m > self._travel_m - TOUCH_M
        struck = self._there and not before
        self.crashes += struck
        return struck


class Twin:
    """Robot behind a pseudo-terminal, a TCP port and a Zenoh session: `async with Twin(config) as twin`.

    Entering raises DeviceError if a port is not available. `faults` injects faults, `state` is the true state.
    """

    def __init__(
        self,
        config: Config,
        body: Body | None = None,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Create the robot with the daemon's configuration; by default its body is the nominal simulated one."""
        drivers = config.drivers
        self.faults = Faults(clock)
        self._body: Body = body or SimulatedBody()
        self.teensy, self.dryve = TeensyDevice(), DryveDevice(drivers.rail)
        self._clock, self._device_clock = clock, DeviceClock(clock)
        self._port = TeensyPort(
            Path(drivers.regulator.port),
            self.teensy,
            self.faults,
            self._device_clock,
            lambda: self._body.gauge().pressure_kpa,
        )
        self._server = DryveServer(drivers.rail.host, drivers.rail.port, self.dryve, self.faults, self._device_clock)
        self._cameras = Cameras(drivers.mocap, self.faults)
        self._ends = EndStops(self._body.travel_m)
        self._vented, self._braked = Since(), Since()
        self._task: asyncio.Task[None] | None = None
        self.state = self._observe(clock())

    async def __aenter__(self) -> Self:
        self._sense()
        async with contextlib.AsyncExitStack() as undo:
            # First, so that a second twin fails here, before it replaces the link of the first.
            await self._server.open()
            undo.push_async_callback(self._server.close)
            self._port.open()
            undo.callback(self._port.close)
            self._cameras.open()
            self._task = asyncio.create_task(self._pace(), name="twin")
            undo.pop_all()
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
        self._port.close()
        await self._server.close()
        await asyncio.to_thread(self._cameras.close)

    async def wait(self) -> None:
        """Wait until the twin fails, and raise its error."""
        if self._task is not None:
            await asyncio.shield(self._task)

    async def _pace(self) -> None:
        """Advance 120 frames a second on absolute deadlines; missed frames are simulated but not published."""
        start_ns, frame = self._clock(), 0
        while True:
            due = int((self._clock() - start_ns) * FRAME_HZ / 1e9)
            if due > frame + CATCH_UP_FRAMES:
                start_ns, due = start_ns + round((due - frame - 1) * 1e9 / FRAME_HZ), frame + 1
            if due > frame:
                self._advance(_instant_ns(due) - _instant_ns(frame))
                self._publish(due, start_ns + _instant_ns(due), due // STATE_EVERY > frame // STATE_EVERY)
                frame = due
            next_ns = start_ns + _instant_ns(frame + 1)
            await asyncio.sleep(max(0, next_ns - self._clock()) / 1e9)

    def _advance(self, duration_ns: int) -> None:
        self._device_clock.step()
        self._cameras.receive_faults()
        self._port.step()
        self._server.step()
        self._body.step(self.dryve.target_velocity_m_s, self.teensy.set_point_kpa, duration_ns)
        if self._ends.update(self._body.truth.cart_position_m):
            self.dryve.trip(LIMIT_SWITCH)
        self._sense()
        self.state = self._observe(self._clock())

    def _publish(self, frame: int, t_capture_ns: int, with_state: bool) -> None:
        for seen in self._body.frames()[-1:]:
            age_ns = self._body.now_ns - seen.t_capture_ns
            self._cameras.publish_frame(frame, t_capture_ns - age_ns, seen.bodies)
        if with_state:
            self._cameras.publish_state(self.state)

    def _sense(self) -> None:
        reading = self._body.encoder()
        self.dryve.sense(reading.position_m, reading.velocity_m_s)

    def _observe(self, now_ns: int) -> TwinState:
        truth, drive = self._body.truth, self.dryve
        tip_y_m, tip_z_m = truth.tip_m
        vented = self.teensy.set_point_kpa == VENT_KPA
        return TwinState(
            t_ns=now_ns,
            cart_position_m=truth.cart_position_m,
            cart_velocity_m_s=truth.cart_velocity_m_s,
            pressure_kpa=truth.pressure_kpa,
            tip_y_m=tip_y_m,
            tip_z_m=tip_z_m,
            vented=vented,
            vented_since_ns=self._vented.update(vented, now_ns),
            drive=drive.state.value,
            braked_since_ns=self._braked.update(abs(truth.cart_velocity_m_s) < BRAKED_M_S, now_ns),
            halted_after_s=None
            if drive.moved_ns is None or drive.halted_ns is None
            else (drive.halted_ns - drive.moved_ns) * 1e-9,
            cart_max_abs_m=self._ends.cart_max_abs_m,
            crashes=self._ends.crashes,
            faults=self.faults.lasting,
        )


def _instant_ns(frame: int) -> int:
    """Return the time of a frame from its number, so that rounding does not accumulate."""
    return round(frame * 1e9 / FRAME_HZ)


async def run_twin(config: Config, body: Body, faults: Sequence[bytes], on_ready: Callable[[str], None]) -> int:
    """Run the twin until SIGINT or SIGTERM and return the signal's number.

    The faults are messages for `Faults.apply`, active from the start. `on_ready` receives one line with the open ports.

    Raises:
        DeviceError: A port is not available.
    """
    stop, signals = asyncio.Event(), []

    def end(number: int) -> None:
        signals.append(number)
        stop.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, end, number)
    async with Twin(config, body) as twin:
        for fault in faults:
            twin.faults.apply(fault)
        drivers = config.drivers
        # Compiling leaves many objects: a collection that visits them would pause the robot for 100 ms.
        gc.collect()
        gc.freeze()
        on_ready(
            f"regulator at {drivers.regulator.port}, rail at {drivers.rail.host}:{drivers.rail.port}, "
            f"motion capture to {drivers.mocap.endpoint} on {drivers.mocap.key}"
        )
        ends = [asyncio.create_task(twin.wait()), asyncio.create_task(stop.wait())]
        done, pending = await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
        for task in pending:
            task.cancel()
        for task in done:
            task.result()
    return signals[0] if signals else 0
