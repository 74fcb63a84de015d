"""Cost of a simulated plan, in pure numpy."""

import numpy as np

from softarm.policies.base import Array
from softarm.schemas.config import RailLimits

# Weights in metres.
CLOSE_M = 0.010  # nearer than this is near enough
FAR_M, FAR_WEIGHT = 0.030, 10.0  # beyond this distance the target is probably missed; weight of each metre beyond
WAIT_M_S = 0.03  # per second of flight
RAIL_M, RAIL_WEIGHT = 0.237, 10.0  # position at which a cart must be able to stop
BRAKING_M_S2 = RailLimits().braking_m_s2  # by the law of the safety filter


def cost(path: Array, target_m: Array, period_s: float) -> Array:
    """Return the costs [N] of paths: the smallest distance from the target plus the cost of the way there.

    Args:
        path: Cart y and velocity, tip y and z, [T, 4, N]; a path with NaN has infinite cost.
        target_m: y and z, [2].
        period_s: Time between two points of a path.
    """
    cart, velocity, tip_y, tip_z = (path[:, row] for row in range(4))
    off_y, off_z = tip_y - target_m[0], tip_z - target_m[1]
    distance = np.sqrt(off_y * off_y + off_z * off_z)  # np.hypot takes several times as long
    worth = np.maximum(distance - np.float32(CLOSE_M), 0.0)
    worth += FAR_WEIGHT * np.maximum(distance - np.float32(FAR_M), 0.0)
    worth += (WAIT_M_S * period_s * np.arange(len(path), dtype=np.float32))[:, None]
    stop = cart + np.float32(0.5 / BRAKING_M_S2) * velocity * np.abs(velocity)
    reach = np.maximum(np.abs(stop, out=stop), np.abs(cart)).max(axis=0)
    total = worth.min(axis=0) + RAIL_WEIGHT * np.maximum(reach - np.float32(RAIL_M), 0.0)
    return np.where(np.isnan(total), np.float32(np.inf), total).astype(np.float32)
