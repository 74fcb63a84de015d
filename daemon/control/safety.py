"""The last thing before the actuators: turns any action, however wrong, into one within the limits.

Needs nothing but numbers. The rail's bounds come from a worst-case prediction of the cart: commands already
under way act for the configured latency, the new one for a tick, and only then can a brake begin to act. The
cart is taken to speed up by `surge_m_s2` and to brake by `braking_m_s2`: the drive's ramp, helped or hindered
by the swinging arm.
"""

import math
from collections import deque
from typing import NamedTuple

from softarm.schemas.config import Limits
from softarm.schemas.messages import SAFE, Command

RETURN_SPEED_M_S = 0.1  # at most, when the cart has to come back by itself
CREEP_MAX_M_S = 0.1  # a larger lead is a ramp under way
_BISECTIONS = 12  # of a 2 m/s range: 0.5 mm/s, always on the safe side


class Filtered(NamedTuple):
    """A command within the limits, and the names of those that changed it."""

    command: Command
    clamps: tuple[str, ...]


class Cart(NamedTuple):
    """The axis's own read-back, carried forward to now."""

    position_m: float
    velocity_m_s: float


def _ramp(cart: Cart, target_m_s: float, time_s: float, up_m_s2: float, down_m_s2: float) -> Cart:
    """Let the velocity ramp to the target for a while: `up` towards +y, `down` towards -y."""
    position, velocity = cart
    slope = up_m_s2 if target_m_s > velocity else -down_m_s2
    ramping = min(time_s, (target_m_s - velocity) / slope)
    position += velocity * ramping + 0.5 * slope * ramping * ramping
    velocity += slope * ramping
    return Cart(position + velocity * (time_s - ramping), velocity)


class SafetyFilter:
    """Holds the cart to its position, velocity and acceleration and the muscle to its pressure and slew."""

    def __init__(self, limits: Limits, period_s: float, drive_ramp_m_s2: float | None) -> None:
        """`drive_ramp_m_s2`: the ramp the drive itself keeps; None when it has none."""
        self._rail = limits.rail
        self._pressure = limits.pressure
        self._period_s = period_s
        self._slews = drive_ramp_m_s2 is None or drive_ramp_m_s2 > limits.rail.acceleration_max_m_s2
        pending = math.ceil(limits.rail.latency_s / period_s - 1e-9)
        self._pending: deque[float] = deque([0.0] * pending, maxlen=pending)  # sent, not yet acting
        self._sent_velocity = 0.0
        self._sent_pressure = 0.0

    def apply(self, wanted: Command, cart: Cart | None) -> Filtered:
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
        self._pending.append(self._sent_velocity)
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

    def _bound_velocity(self, wanted: float, cart: Cart | None) -> tuple[float, tuple[str, ...]]:
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
        upper = self._highest(velocity, cart, self._rail.position_max_m)
        if upper < velocity:
            clamps.append("rail_position_max")
        mirrored = Cart(-cart.position_m, -cart.velocity_m_s)
        lower = -self._highest(-upper, mirrored, -self._rail.position_min_m, mirror=-1.0)
        if lower > upper:
            clamps.append("rail_position_min")
            if upper < velocity:  # both ends at once: the numbers are wrong; stand still
                return 0.0, tuple(clamps)
        return lower, tuple(clamps)

    def _highest(self, wanted: float, cart: Cart, limit_m: float, mirror: float = 1.0) -> float:
        """The highest set-point, up to `wanted`, after which the cart can still stop before the limit."""
        aim = limit_m - self._rail.margin_m
        creep = self._creep(cart.velocity_m_s - mirror * (self._pending[0] if self._pending else 0.0))
        now = cart
        remaining = self._rail.latency_s
        for sent in self._pending:
            time = min(remaining, self._period_s)
            now = self._predict(now, mirror * sent + creep, time)
            remaining -= time
        if self._stops_at(now, wanted + creep) <= aim:
            return wanted
        low, high = -RETURN_SPEED_M_S, wanted
        if high <= low or self._stops_at(now, low + creep) > aim:
            return min(low, wanted)
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            if self._stops_at(now, middle + creep) <= aim:
                low = middle
            else:
                high = middle
        return low

    @staticmethod
    def _creep(lead_m_s: float) -> float:
        """How fast the arm drags a cart that holds its velocity: a small, steady lead over its set-point."""
        return lead_m_s if 0.0 < lead_m_s < CREEP_MAX_M_S else 0.0

    def _predict(self, cart: Cart, target: float, time_s: float) -> Cart:
        return _ramp(cart, target, time_s, self._rail.surge_m_s2, self._rail.braking_m_s2)

    def _stops_at(self, now: Cart, candidate: float) -> float:
        """Farthest point towards +y still ahead when the candidate acts for a tick and the brake after it."""
        position, velocity = self._predict(now, candidate, self._period_s)
        if velocity > 0.0:
            return position + velocity * velocity / (2.0 * self._rail.braking_m_s2)
        if now.velocity_m_s > 0.0:  # it turned round on the way
            return now.position_m + now.velocity_m_s**2 / (2.0 * self._rail.braking_m_s2)
        return position
