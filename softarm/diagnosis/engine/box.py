"""Least squares within bounds, for many small problems: coordinate descent finds the active bounds."""

# mypy: allow-untyped-defs, allow-untyped-calls
from pathlib import Path

import numpy as np

from softarm.simulator.compiled import compiler

compiled = compiler(Path(__file__))

ROUNDS, SWEEPS = 40, 10
FINE = 1e-12  # tolerance, in units of the largest initial gradient


@compiled
def solve(normal, slope, low, high):
    """Minimise x' normal x / 2 - slope' x within low <= x <= high.

    A round is a few sweeps of coordinate descent, which find the active bounds, and one exact solution of the free
    coordinates within the box. The exact step handles nearly collinear columns.

    Args:
        normal: symmetric, contiguous matrix, [q, q].
        slope: right-hand side, [q].
        low: lower bounds, [q].
        high: upper bounds, [q].
    """
    q = len(slope)
    x = np.minimum(np.maximum(np.zeros(q), low), high)
    if q == 0:
        return x
    ridge = 1e-12 * (np.trace(normal) / q) + 1e-30
    gradient = normal @ x - slope
    most = np.abs(gradient).max()
    for _ in range(ROUNDS):
        for _ in range(SWEEPS):
            for i in range(q):
                new = min(max(x[i] - gradient[i] / (normal[i, i] + ridge), low[i]), high[i])
                change = new - x[i]
                if change != 0.0:
                    x[i] = new
                    for j in range(q):
                        gradient[j] += change * normal[j, i]
        free = np.flatnonzero((x > low) & (x < high))
        if len(free) == 0 or np.abs(gradient[free]).max() <= FINE * most:
            break
        block = np.empty((len(free), len(free)))
        for a in range(len(free)):
            for b in range(len(free)):
                block[a, b] = normal[free[a], free[b]]
            block[a, a] += ridge
        step = np.linalg.solve(block, -gradient[free])
        share = 1.0
        for a in range(len(free)):
            reach = (high[free[a]] - x[free[a]]) if step[a] > 0.0 else (low[free[a]] - x[free[a]])
            if step[a] != 0.0:
                share = min(share, reach / step[a])
        for a in range(len(free)):
            x[free[a]] = min(max(x[free[a]] + share * step[a], low[free[a]]), high[free[a]])
        gradient = normal @ x - slope
    return x
