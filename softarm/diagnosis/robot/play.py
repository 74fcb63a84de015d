"""Position of a cart with play behind its drive."""

# mypy: allow-untyped-defs, allow-untyped-calls
from pathlib import Path

import numpy as np

from softarm.simulator.compiled import compiler

compiled = compiler(Path(__file__))


@compiled
def coasting(way, speed, half, pushed_m_s2, step_s):
    """Return the cart's position [T, K], m: free between the flanks, pushed by the arm, stopped by a flank.

    Args:
        way: middle of the play, which the drive moves, [T, K], m.
        speed: its velocity, [T, K], m/s.
        half: half the play, m.
        pushed_m_s2: acceleration of the free cart, [T, K], m/s^2.
        step_s: time between samples, s.
    """
    cart = np.empty_like(way)
    for k in range(way.shape[1]):
        place, rate = way[0, k], speed[0, k]
        for t in range(way.shape[0]):
            rate += pushed_m_s2[t, k] * step_s
            place += rate * step_s
            ahead = place - way[t, k]
            if ahead > half:
                ahead, rate = half, min(rate, speed[t, k])
            elif ahead < -half:
                ahead, rate = -half, max(rate, speed[t, k])
            place = way[t, k] + ahead
            cart[t, k] = place
    return cart
