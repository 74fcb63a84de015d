"""The daemon's braking clamp for a whole batch, so that policies learn with the brakes they will fly with.

Same law as `daemon/control/safety.py` at its default limits (rooms do not import each other upwards; a test holds the
two together): the command before acts for the latency, the candidate for one tick, then the cart must be able to
brake before the limit.
"""

import numpy as np
from numpy.typing import NDArray

from softarm.schemas.config import RailLimits

Array = NDArray[np.float32]

RETURN_SPEED_M_S = 0.1
CREEP_MAX_M_S = 0.1
_BISECTIONS = 12


class RailGuard:
    """Clamps velocity commands of a batch; remembers the command before."""

    def __init__(self, robots: int, period_s: float, limits: RailLimits | None = None) -> None:
        """Raises ValueError when the latency is longer than a tick: one command on the way is what it knows."""
        self._limits = limits or RailLimits()
        self._period_s = period_s
        if self._limits.latency_s > period_s * (1 + 1e-9):
            raise ValueError(
                f"latency_s is {self._limits.latency_s}; the batch clamp takes at most one period of {period_s} s"
            )
        self.sent_m_s = np.zeros(robots, dtype=np.float32)  # the command before

    def reset(self, robots: NDArray[np.bool_]) -> None:
        """Robots [R] whose command before is zero."""
        self.sent_m_s[robots] = 0.0

    def apply(self, wanted_m_s: Array, position_m: Array, velocity_m_s: Array) -> Array:
        """Commands that keep the carts inside the limits, float32 [R]."""
        limits, before = self._limits, self.sent_m_s
        wanted = np.clip(wanted_m_s, -limits.velocity_max_m_s, limits.velocity_max_m_s)
        upper = self._highest(wanted, position_m, velocity_m_s, before, limits.position_max_m)
        lower = -self._highest(-upper, -position_m, -velocity_m_s, -before, -limits.position_min_m)
        both_ends = (lower > upper) & (upper < wanted)
        self.sent_m_s = np.where(both_ends, 0.0, lower).astype(np.float32)
        return self.sent_m_s.copy()

    def _highest(self, wanted: Array, position: Array, velocity: Array, before: Array, limit_m: float) -> Array:
        """The highest set-point, up to `wanted`, after which each cart can still stop before the limit."""
        aim = limit_m - self._limits.margin_m
        lead = velocity - before
        creep = np.where((lead > 0.0) & (lead < CREEP_MAX_M_S), lead, np.float32(0.0))
        now_position, now_velocity = self._ramp(position, velocity, before + creep, self._limits.latency_s)
        highest = wanted.copy()
        tight = np.flatnonzero(self._stops_at(now_position, now_velocity, wanted + creep) > aim)
        if tight.size == 0:  # most carts are far from the ends
            return highest
        now_position, now_velocity, creep = now_position[tight], now_velocity[tight], creep[tight]
        high = wanted[tight]
        low = np.minimum(high, np.float32(-RETURN_SPEED_M_S))
        searched = (high > low) & (self._stops_at(now_position, now_velocity, low + creep) <= aim)
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            fits = self._stops_at(now_position, now_velocity, middle + creep) <= aim
            low = np.where(searched & fits, middle, low)
            high = np.where(searched & ~fits, middle, high)
        highest[tight] = low
        return highest

    def _ramp(self, position: Array, velocity: Array, target: Array, time_s: float) -> tuple[Array, Array]:
        slope = np.where(target > velocity, self._limits.surge_m_s2, -self._limits.braking_m_s2).astype(np.float32)
        ramping = np.minimum(time_s, (target - velocity) / slope)
        position = position + velocity * ramping + 0.5 * slope * ramping**2
        velocity = velocity + slope * ramping
        return position + velocity * (time_s - ramping), velocity

    def _stops_at(self, now_position: Array, now_velocity: Array, candidate: Array) -> Array:
        """Farthest point still ahead when the candidate acts for a tick and the brake after it."""
        brake = 2.0 * self._limits.braking_m_s2
        position, velocity = self._ramp(now_position, now_velocity, candidate, self._period_s)
        turned = np.where(now_velocity > 0.0, now_position + now_velocity**2 / brake, position)
        return np.where(velocity > 0.0, position + velocity**2 / brake, turned)
