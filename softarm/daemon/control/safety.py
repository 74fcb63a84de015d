"""Safety filter: turns any requested command, however wrong, into one within the limits.

It is the last step before the actuators and needs only numbers. The rail's bounds come from the braking law
(`common/braking.py`), which policies train with: it uses the age of the axis reading and the commands sent since.
"""

import math
from collections import deque
from typing import NamedTuple

from softarm.schemas.config import Limits
from softarm.schemas.messages import SAFE, Command, RailReading

KNOWN_S = 0.5  # with an older axis reading the position of the cart is unknown


class Filtered(NamedTuple):
    """A command within the limits, and the names of the limits that changed it."""

    command: Command
    clamps: tuple[str, ...]


class SafetyFilter:
    """Filter for position and velocity of the cart and for pressure and slew of the muscle.

    The cart's acceleration is the drive's ramp, which the configuration refuses above the limit.
    """

    def __init__(self, limits: Limits, period_s: float, hold_s: float) -> None:
        """Create a filter that has sent nothing yet.

        Args:
            limits: Limits of cart and muscle.
            period_s: Duration of a tick.
            hold_s: The rail's link brakes if no set-point arrives for this long.
        """
        self._rail = limits.rail
        self._pressure = limits.pressure
        self._period_s = period_s
        self._law = limits.rail.braking_law(hold_s)
        self.sent: deque[tuple[int, float]] = deque()  # time (ns) and velocity (m/s) that may still act
        self._remembered_ns = round((KNOWN_S + hold_s + self._law.latency_s) * 1e9)
        self._sent_pressure = 0.0

    def apply(self, requested: Command, rail: RailReading | None, t_ns: int) -> Filtered:
        """Return the command to send at `t_ns`.

        Without a known cart position it brakes; with NaN or infinity it brakes and vents.
        """
        age_s = math.inf if rail is None else max(0, t_ns - rail.t_receive_ns) * 1e-9
        filtered = self._bound(requested, rail if age_s <= KNOWN_S else None, age_s, t_ns)
        self.sent.append((t_ns, filtered.command.cart_velocity_m_s))
        self._sent_pressure = filtered.command.pressure_kpa
        while self.sent[0][0] < t_ns - self._remembered_ns:
            self.sent.popleft()
        return filtered

    def resume(self, sent: Command) -> None:
        """Replace the last sent command: for the replay of a log with gaps."""
        t_ns, _ = self.sent.pop()
        self.sent.append((t_ns, sent.cart_velocity_m_s))
        self._sent_pressure = sent.pressure_kpa

    def _bound(self, requested: Command, rail: RailReading | None, age_s: float, t_ns: int) -> Filtered:
        if not requested.enable:
            return Filtered(SAFE, ())
        read = () if rail is None else (rail.position_m, rail.velocity_m_s)
        if not all(map(math.isfinite, (requested.cart_velocity_m_s, requested.pressure_kpa, *read))):
            return Filtered(Command(requested.enable, 0.0, 0.0), ("non_finite",))
        velocity, clamps = self._bound_velocity(requested.cart_velocity_m_s, rail, age_s, t_ns)
        pressure, pressure_clamps = self._bound_pressure(requested.pressure_kpa)
        return Filtered(Command(requested.enable, velocity, pressure), clamps + pressure_clamps)

    def _bound_pressure(self, requested: float) -> tuple[float, tuple[str, ...]]:
        limits, clamps = self._pressure, []
        if requested > limits.max_kpa:
            requested, clamps = limits.max_kpa, ["pressure_max"]
        elif requested < limits.min_kpa:
            requested, clamps = limits.min_kpa, ["pressure_min"]
        step = limits.slew_max_kpa_s * self._period_s
        slewed = min(max(requested, self._sent_pressure - step), self._sent_pressure + step)
        if slewed != requested:
            clamps.append("pressure_slew")
        return slewed, tuple(clamps)

    def _bound_velocity(
        self, requested: float, rail: RailReading | None, age_s: float, t_ns: int
    ) -> tuple[float, tuple[str, ...]]:
        if rail is None:
            return 0.0, ("rail_unknown",) if requested != 0.0 else ()
        clamps: list[str] = []
        top = self._rail.velocity_max_m_s
        velocity = min(max(requested, -top), top)
        if velocity != requested:
            clamps.append("rail_velocity")
        sent = [((t_ns - sent_ns) * 1e-9, each) for sent_ns, each in self.sent]
        velocity, at_max, at_min = self._law.bound(velocity, rail.position_m, rail.velocity_m_s, age_s, sent)
        if at_max:
            clamps.append("rail_position_max")
        if at_min:
            clamps.append("rail_position_min")
        return velocity, tuple(clamps)
