"""Least squares in a box, many small problems: coordinate descent on the normal equations, compiled."""

# mypy: allow-untyped-defs, allow-untyped-calls
import numpy as np
from numba import njit

SWEEPS = 400


@njit(cache=True)
def solve(normal, slope, low, high):
    """Minimise x' normal x / 2 - slope' x within low <= x <= high; normal [q, q] symmetric, the rest [q]."""
    q = len(slope)
    x = np.minimum(np.maximum(np.zeros(q), low), high)
    ridge = 1e-9 * (np.trace(normal) / max(q, 1)) + 1e-30
    gradient = normal @ x - slope
    for _ in range(SWEEPS):
        moved = 0.0
        for i in range(q):
            curvature = normal[i, i] + ridge
            new = min(max(x[i] - (gradient[i] + ridge * x[i]) / curvature, low[i]), high[i])
            step = new - x[i]
            if step != 0.0:
                x[i] = new
                for j in range(q):
                    gradient[j] += step * normal[j, i]
                moved = max(moved, step * step * curvature)
        if moved < 1e-10:
            break
    return x
