"""The daemon's braking clamp for a whole batch, so that policies learn with the brakes they will fly with."""

import numpy as np
from numpy.typing import NDArray

from softarm.schemas.config import RailLimits

Array = NDArray[np.float32]


class RailGuard:
    """Clamps velocity commands of a batch by the braking law; remembers the command before."""

    def __init__(self, robots: int, period_s: float, limits: RailLimits | None = None) -> None:
        """Raises ValueError when the latency is longer than a tick: one command on the way is what it knows."""
        limits = limits or RailLimits()
        law = limits.braking_law(period_s)
        if law.under_way > 1:
            raise ValueError(
                f"latency_s is {limits.latency_s}; the batch clamp takes at most one period of {period_s} s"
            )
        self._under_way = law.under_way
        self._law = law.in_float32()
        self._velocity_max_m_s = limits.velocity_max_m_s
        self.sent_m_s = np.zeros(robots, dtype=np.float32)  # the command before

    def reset(self, robots: NDArray[np.bool_]) -> None:
        """Robots [R] whose command before is zero."""
        self.sent_m_s[robots] = 0.0

    def apply(self, wanted_m_s: Array, position_m: Array, velocity_m_s: Array) -> Array:
        """Commands that keep the carts inside the limits, float32 [R]."""
        wanted = np.clip(wanted_m_s, -self._velocity_max_m_s, self._velocity_max_m_s)
        under_way = (self.sent_m_s,) * self._under_way
        self.sent_m_s = self._law.bound(wanted, position_m, velocity_m_s, under_way).velocity_m_s
        return self.sent_m_s.copy()
