"""Cost of a simulated plan, in pure numpy."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softarm.schemas.config import RailLimits

Array = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Cost:
    """Weights in metres: the cost of a plan is its smallest distance plus the cost of the way there."""

    close_m: float = 0.010  # nearer than this is near enough
    far_m: float = 0.030  # beyond this distance the target is probably missed
    far_weight: float = 10.0  # of each metre beyond
    wait_m_s: float = 0.03  # per second of flight
    rail_m: float = 0.237  # position at which a cart must be able to stop
    rail_weight: float = 10.0
    braking_m_s2: float = RailLimits().braking_m_s2  # by the law of the safety filter

    def of(self, path: Array, target_m: Array, period_s: float) -> Array:
        """Return costs [N] of paths [T, 4, N] (cart y and velocity, tip y and z) to a target [2]; NaN is infinite."""
        cart, velocity, tip_y, tip_z = (path[:, row] for row in range(4))
        distance = np.hypot(tip_y - target_m[0], tip_z - target_m[1])
        worth = np.maximum(distance - np.float32(self.close_m), 0.0)
        worth += self.far_weight * np.maximum(distance - np.float32(self.far_m), 0.0)
        worth += (self.wait_m_s * period_s * np.arange(len(path), dtype=np.float32))[:, None]
        stop = cart + np.float32(0.5 / self.braking_m_s2) * velocity * np.abs(velocity)
        reach = np.maximum(np.abs(stop), np.abs(cart)).max(axis=0)
        cost = worth.min(axis=0) + self.rail_weight * np.maximum(reach - np.float32(self.rail_m), 0.0)
        return np.where(np.isnan(cost), np.float32(np.inf), cost).astype(np.float32)
