"""The last thing before the actuators: turns any action, however wrong, into one within the limits.

Needs nothing but numbers. The rail's bounds come from the braking law (`common/braking.py`), the same that policies
train with: it is told how old the axis's reading is, and everything that was sent since it may have begun to matter.
"""

import math
from collections import deque
from typing import NamedTuple

from softarm.schemas.config import Limits
from softarm.schemas.messages import SAFE, Command, RailReading

KNOWN_S = 0.5  # an axis reading older than this says nothing of where the cart is


class Filtered(NamedTuple):
    """A command within the limits, and the names of those that changed it."""

    command: Command
    clamps: tuple[str, ...]


class SafetyFilter:
    """Holds the cart to its position, velocity and acceleration and the muscle to its pressure and slew."""

    def __init__(self, limits: Limits, period_s: float, drive_ramp_m_s2: float | None, hold_s: float) -> None:
        """`drive_ramp_m_s2`: the ramp the drive itself keeps; None when it has none.

        hold_s: a set-point that is not renewed for so long makes the rail's link brake.
        """
        self._rail = limits.rail
        self._pressure = limits.pressure
        self._period_s = period_s
        self._slews = drive_ramp_m_s2 is None or drive_ramp_m_s2 > limits.rail.acceleration_max_m_s2
        self._law = limits.rail.braking_law(hold_s)
        self.sent: deque[tuple[int, float]] = deque()  # when (ns) and what (m/s), as far back as it may matter
        self._remembered_ns = round((KNOWN_S + hold_s + self._law.latency_s) * 1e9)
        self._sent_pressure = 0.0

    def apply(self, wanted: Command, rail: RailReading | None, t_ns: int) -> Filtered:
        """Bound a command that would be sent at `t_ns`.

        Without a known cart it brakes; with a number that is none it brakes and vents.
        """
        age_s = math.inf if rail is None else max(0, t_ns - rail.t_receive_ns) * 1e-9
        filtered = self._bound(wanted, rail if age_s <= KNOWN_S else None, age_s, t_ns)
        self.sent.append((t_ns, filtered.command.cart_velocity_m_s))
        self._sent_pressure = filtered.command.pressure_kpa
        while self.sent[0][0] < t_ns - self._remembered_ns:
            self.sent.popleft()
        return filtered

    def resume(self, sent: Command) -> None:
        """Another command than the last one was sent in its place: for the replay of a log with gaps."""
        t_ns, _ = self.sent.pop()
        self.sent.append((t_ns, sent.cart_velocity_m_s))
        self._sent_pressure = sent.pressure_kpa

    def _bound(self, wanted: Command, rail: RailReading | None, age_s: float, t_ns: int) -> Filtered:
        if not wanted.enable:
            return Filtered(SAFE, ())
        read = () if rail is None else (rail.position_m, rail.velocity_m_s)
        if not all(map(math.isfinite, (wanted.cart_velocity_m_s, wanted.pressure_kpa, *read))):
            return Filtered(Command(wanted.enable, 0.0, 0.0), ("non_finite",))
        velocity, clamps = self._bound_velocity(wanted.cart_velocity_m_s, rail, age_s, t_ns)
        pressure, pressure_clamps = self._bound_pressure(wanted.pressure_kpa)
        return Filtered(Command(wanted.enable, velocity, pressure), clamps + pressure_clamps)

    def _bound_pressure(self, wanted: float) -> tuple[float, tuple[str, ...]]:
        limits, clamps = self._pressure, []
        if wanted > limits.max_kpa:
            wanted, clamps = limits.max_kpa, ["pressure_max"]
        elif wanted < limits.min_kpa:
            wanted, clamps = limits.min_kpa, ["pressure_min"]
        step = limits.slew_max_kpa_s * self._period_s
        slewed = min(max(wanted, self._sent_pressure - step), self._sent_pressure + step)
        if slewed != wanted:
            clamps.append("pressure_slew")
        return slewed, tuple(clamps)

    def _bound_velocity(
        self, wanted: float, rail: RailReading | None, age_s: float, t_ns: int
    ) -> tuple[float, tuple[str, ...]]:
        if rail is None:
            return 0.0, ("rail_unknown",) if wanted != 0.0 else ()
        clamps: list[str] = []
        top = self._rail.velocity_max_m_s
        velocity = min(max(wanted, -top), top)
        if velocity != wanted:
            clamps.append("rail_velocity")
        if self._slews:
            step = self._rail.acceleration_max_m_s2 * self._period_s
            before = self.sent[-1][1] if self.sent else 0.0
            slewed = min(max(velocity, before - step), before + step)
            if slewed != velocity:
                clamps.append("rail_acceleration")
            velocity = slewed
        # Position comes last: braking for the end of the rail may need more than the slew allows.
        sent = [((t_ns - sent_ns) * 1e-9, each) for sent_ns, each in self.sent]
        velocity, at_max, at_min = self._law.bound(velocity, rail.position_m, rail.velocity_m_s, age_s, sent)
        if at_max:
            clamps.append("rail_position_max")
        if at_min:
            clamps.append("rail_position_min")
        return velocity, tuple(clamps)
