"""Generation and variation of plans, in pure numpy with a given random generator.

A plan has one command per control step, each in -1 .. 1: float32 [2, T, N], cart velocity then pressure.
"""

import numpy as np

from softarm.policies.base import Array

KNOT_STEPS = 5  # control steps between the knots of a change
SPREAD_LOW, SPREAD_HIGH = 0.02, 1.0  # standard deviation of a change, share of half the range
CROSSING_SHARE = 0.5  # of the new plans, crossed with the difference of two others
SWING_HZ = (0.4, 2.5)  # around the arm's first bending mode


def swings(random: np.random.Generator, steps: int, count: int, period_s: float) -> Array:
    """Draw new swinging plans: sinusoids of random frequency and phase, many strong enough to saturate."""
    time_s = period_s * np.arange(steps, dtype=np.float32)[:, None]
    turns_per_s = random.uniform(*SWING_HZ, count)
    waves = []
    for _ in range(2):
        strength = np.exp(random.uniform(np.log(0.2), np.log(4.0), count))
        phase = random.uniform(0.0, 2 * np.pi, count)
        level = random.uniform(-1.0, 1.0, count) * (random.random(count) < 0.5)
        waves.append(level + strength * np.sin(2 * np.pi * turns_per_s * time_s + phase))
    plans: Array = np.clip(np.stack(waves), -1.0, 1.0).astype(np.float32)
    return plans


def variations(random: np.random.Generator, elites: Array, count: int) -> Array:
    """Draw plans [2, T, count] near good ones [2, T, E], best first.

    Each is an elite, at times crossed with the difference of two others (differential evolution), plus a piecewise
    linear change of its own strength.
    """
    steps, kept = elites.shape[1], elites.shape[2]
    parents = (kept * random.random(count, dtype=np.float32) ** 2).astype(np.int64)
    plans: Array = elites.take(parents, axis=2)
    crossing = int(CROSSING_SHARE * count)
    if kept > 1:
        one, other = random.integers(0, kept, (2, crossing))
        share = random.uniform(0.0, 0.9, crossing).astype(np.float32)
        plans[:, :, :crossing] += share * (elites.take(one, axis=2) - elites.take(other, axis=2))
    spread = np.exp(random.uniform(np.log(SPREAD_LOW), np.log(SPREAD_HIGH), (2, 1, count))).astype(np.float32)
    spread *= random.random((2, 1, count)) < 0.75  # some change one command alone
    knots = (steps + KNOT_STEPS - 2) // KNOT_STEPS + 2
    heights = random.standard_normal((2, knots, count), dtype=np.float32) * spread
    place = (np.arange(steps) + random.integers(KNOT_STEPS)) / KNOT_STEPS
    weights = np.maximum(0.0, 1.0 - np.abs(place[:, None] - np.arange(knots))).astype(np.float32)
    plans += weights @ heights
    np.clip(plans, -1.0, 1.0, out=plans)
    return plans
