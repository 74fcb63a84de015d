"""Thins the log of an arm that is switched off and unchanged. Pure.

A flight and the time around every change are kept completely. Ticks wait until they are `around_s` old, so those before
a change can still be written.
"""

import math
from collections import deque

from softarm.daemon.control.records import Inputs, Mode, Outputs, Tick
from softarm.schemas.messages import MocapFrame

OFF = (Mode.DISARMED, Mode.STOPPED)
# Smaller changes are sensor noise.
STILL_M, STILL_RAD, STILL_KPA = 0.005, 0.03, 0.5


class Thinning:
    """Selects the ticks to be written, in their order."""

    def __init__(self, interval_s: float, around_s: float) -> None:
        """Keep a tick per interval of an unchanged arm (0: all), and all ticks around a change."""
        self._interval_ns, self._around_ns = round(interval_s * 1e9), round(around_s * 1e9)
        self._waiting: deque[Tick] = deque()
        self._before: Outputs | None = None  # of the tick before
        self._state: object = None  # and what the devices said of themselves
        self._written: Inputs | None = None  # of the newest tick that was written
        self._frame: MocapFrame | None = None  # the newest up to there
        self._all_until_ns = 0

    def take(self, tick: Tick) -> list[Tick]:
        """Add a tick and return the ticks to be written now."""
        inputs, outputs, _ = tick
        if self._interval_ns == 0 or self._is_news(inputs, outputs):
            self._all_until_ns = inputs.t_ns + self._around_ns
        self._waiting.append(tick)
        if inputs.t_ns <= self._all_until_ns:
            return self.rest()
        due = []
        while self._waiting and inputs.t_ns - self._waiting[0][0].t_ns > self._around_ns:
            old = self._waiting.popleft()
            if self._written is None or old[0].t_ns - self._written.t_ns >= self._interval_ns:
                due.append(self._writes(old))
        return due

    def rest(self) -> list[Tick]:
        """Return all waiting ticks, at a change or the end of the log."""
        due = [self._writes(tick) for tick in self._waiting]
        self._waiting.clear()
        return due

    def begin(self) -> None:
        """Keep the first ticks of a new file completely."""
        self._before = None

    def _writes(self, tick: Tick) -> Tick:
        self._written = tick[0]
        if tick[0].mocap:
            self._frame = tick[0].mocap[-1]
        return tick

    def _is_news(self, inputs: Inputs, outputs: Outputs) -> bool:
        """Return whether the arm is in use or has changed."""
        before, self._before = self._before, outputs
        state, self._state = self._state, _state(inputs, outputs)
        return (
            before is None
            or outputs.mode not in OFF
            or outputs.sent.enable
            or bool(inputs.requests)
            or inputs.missed > 0
            or any(event.name == "mocap_settling" for event in outputs.events)  # it ends after a number of frames
            or state != self._state
            or outputs.goal != before.goal
            or self._moved(inputs)
        )

    def _moved(self, inputs: Inputs) -> bool:
        """Return whether a reading or body differs from the last written one; NaN does not count."""
        was, seen = self._written, self._frame
        if was is None:
            return False
        if abs(_pressure_kpa(inputs) - _pressure_kpa(was)) > STILL_KPA or abs(_cart_m(inputs) - _cart_m(was)) > STILL_M:
            return True
        return seen is not None and any(
            now.tracked is not then.tracked
            or abs(now.y_m - then.y_m) > STILL_M
            or abs(now.z_m - then.z_m) > STILL_M
            or abs(now.angle_rad - then.angle_rad) > STILL_RAD
            for frame in inputs.mocap
            for now, then in zip(frame.bodies, seen.bodies, strict=True)
        )


def _pressure_kpa(inputs: Inputs) -> float:
    return math.nan if inputs.pressure is None else inputs.pressure.pressure_kpa


def _cart_m(inputs: Inputs) -> float:
    return math.nan if inputs.rail is None else inputs.rail.position_m


def _state(inputs: Inputs, outputs: Outputs) -> object:
    """Return the state without measurements and texts, which differ in every tick."""
    pressure, rail, problems = inputs.pressure, inputs.rail, inputs.problems
    return (
        outputs.mode,
        outputs.estop,
        outputs.policy,
        tuple(event.name for event in outputs.events),
        pressure and (pressure.armed, pressure.faults),
        rail and (rail.enabled, rail.remote, rail.faults),
        problems.mocap is None,
        problems.regulator is None,
        problems.rail is None,
        inputs.recorder_dropped,
    )
