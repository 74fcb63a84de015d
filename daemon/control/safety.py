"""The last thing before the actuators: turns any action, however wrong, into one within the limits.

Needs nothing but numbers. The rail's bounds come from the braking law (`common/braking.py`), the same that policies
train with.
"""

import math
from collections import deque
from typing import NamedTuple

from softarm.schemas.config import Limits
from softarm.schemas.messages import SAFE, Command


class Filtered(NamedTuple):
    """A command within the limits, and the names of those that changed it."""

    command: Command
    clamps: tuple[str, ...]


class CartState(NamedTuple):
    """The axis's own read-back, carried forward to now."""

    position_m: float
    velocity_m_s: float


class SafetyFilter:
    """Holds the cart to its position, velocity and acceleration and the muscle to its pressure and slew."""

    def __init__(self, limits: Limits, period_s: float, drive_ramp_m_s2: float | None) -> None:
        """`drive_ramp_m_s2`: the ramp the drive itself keeps; None when it has none."""
        self._rail = limits.rail
        self._pressure = limits.pressure
        self._period_s = period_s
        self._slews = drive_ramp_m_s2 is None or drive_ramp_m_s2 > limits.rail.acceleration_max_m_s2
        self._law = limits.rail.braking_law(period_s)
        under_way = self._law.under_way
        self._under_way: deque[float] = deque([0.0] * under_way, maxlen=under_way)  # sent, not yet acting
        self._sent_velocity = 0.0
        self._sent_pressure = 0.0

    def apply(self, wanted: Command, cart: CartState | None) -> Filtered:
        """Bound a command. Without a known cart state, or with a number that is none, it brakes and vents."""
        if not wanted.enable:
            return self._keep(SAFE, ())
        numbers = (wanted.cart_velocity_m_s, wanted.pressure_kpa, *(cart or ()))
        if not all(map(math.isfinite, numbers)):
            return self._keep(Command(wanted.enable, 0.0, 0.0), ("non_finite",))
        velocity, clamps = self._bound_velocity(wanted.cart_velocity_m_s, cart)
        pressure, pressure_clamps = self._bound_pressure(wanted.pressure_kpa)
        return self._keep(Command(wanted.enable, velocity, pressure), clamps + pressure_clamps)

    def _keep(self, command: Command, clamps: tuple[str, ...]) -> Filtered:
        self._sent_velocity = command.cart_velocity_m_s
        self._sent_pressure = command.pressure_kpa
        self._under_way.append(self._sent_velocity)
        return Filtered(command, clamps)

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

    def _bound_velocity(self, wanted: float, cart: CartState | None) -> tuple[float, tuple[str, ...]]:
        if cart is None:
            return 0.0, ("rail_unknown",) if wanted != 0.0 else ()
        clamps: list[str] = []
        top = self._rail.velocity_max_m_s
        velocity = min(max(wanted, -top), top)
        if velocity != wanted:
            clamps.append("rail_velocity")
        if self._slews:
            step = self._rail.acceleration_max_m_s2 * self._period_s
            slewed = min(max(velocity, self._sent_velocity - step), self._sent_velocity + step)
            if slewed != velocity:
                clamps.append("rail_acceleration")
            velocity = slewed
        # Position comes last: braking for the end of the rail may need more than the slew allows.
        velocity, at_max, at_min = self._law.bound(velocity, cart.position_m, cart.velocity_m_s, self._under_way)
        if at_max:
            clamps.append("rail_position_max")
        if at_min:
            clamps.append("rail_position_min")
        return velocity, tuple(clamps)
