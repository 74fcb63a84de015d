"""Initial guesses of the optimiser: smooth random swings that pass near a target.

A swing's timing has many local optima (swing once, twice, to the right first, ...), which no gradient crosses. A batch
of random swings covers them; every step of every swing is a possible end of a plan.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from softarm.schemas.robot import CONTROL_RATE_HZ
from softarm.training.trajectory import problem
from softarm.training.trajectory.problem import Array, interpolation
from softarm.training.trajectory.rollout import Rollouts

STEPS_MIN = 12  # no target is reached sooner
RAIL_WEIGHT = 2.0  # metres of distance from the target per metre beyond the rail's limit


class Guesses(NamedTuple):
    """Initial guesses, the best of each target first."""

    knots: Array  # [tries, G, knots, 2]
    steps: NDArray[np.int64]  # [tries, G]


class Library(NamedTuple):
    """Library of swings from one start."""

    knots: Array  # [L, knots, 2]
    tip_m: Array  # [steps + 1, L, 2]
    beyond_m: Array  # [steps + 1, L]: farthest beyond the cart's limit so far


def random_knots(count: int, rng: np.random.Generator) -> Array:
    """Draw smooth commands, [count, knots, 2]: a swing of random frequency and phase, and a varying pressure."""
    knots_each = interpolation(problem.STEPS_MAX).shape[1]
    t = np.arange(knots_each) * problem.KNOT_STEPS / CONTROL_RATE_HZ
    frequency, phase = rng.uniform(0.5, 2.2, (count, 1)), rng.uniform(0, 2 * np.pi, (count, 1))
    size = rng.uniform(0.1, 1.2, (count, 1))
    growth = 1.0 + rng.uniform(-0.5, 1.0, (count, 1)) * t / t[-1]
    velocity = size * growth * np.sin(2 * np.pi * frequency * t + phase)
    velocity += rng.normal(0.0, 0.25, (count, knots_each)) * rng.uniform(0, 1, (count, 1))
    middle, swing = rng.uniform(0, 20, (count, 1)), rng.uniform(0, 15, (count, 1))
    pressure = middle + swing * np.sin(2 * np.pi * frequency * t + rng.uniform(0, 2 * np.pi, (count, 1)))
    late = t > rng.uniform(0.0, t[-1], (count, 1))
    pressure = np.where(late, rng.uniform(0, 20, (count, 1)), pressure)
    knots = np.stack((velocity, pressure), axis=2)
    low = (-problem.VELOCITY_MAX_M_S, problem.PRESSURE_MIN_KPA)
    high = (problem.VELOCITY_MAX_M_S, problem.PRESSURE_MAX_KPA)
    clipped: Array = np.clip(knots, low, high).astype(np.float32)
    return clipped


def library(rollouts: Rollouts, cart_start_m: float, count: int, rng: np.random.Generator) -> Library:
    """Simulate random swings from a start."""
    knots = random_knots(count, rng)
    commands = np.tensordot(interpolation(problem.STEPS_MAX), knots, (1, 1))
    motion = rollouts.fly(commands, np.full(count, cart_start_m, dtype=np.float32))
    reserve = np.abs(problem.stopping_m(motion.state[:, :, 0], motion.state[:, :, 1]))
    beyond = np.maximum.accumulate(np.maximum(reserve - problem.RAIL_MAX_M, 0.0), axis=0)
    return Library(knots, motion.tip_m, beyond)


def nearest(swings: Library, targets_m: Array, each: int) -> Guesses:
    """Return the best swings with their best steps, `each` per target [G, 2]."""
    knots, steps = [], []
    for target in targets_m:
        off = swings.tip_m - target
        score = np.sqrt(off[..., 0] * off[..., 0] + off[..., 1] * off[..., 1]) + RAIL_WEIGHT * swings.beyond_m
        score[:STEPS_MIN] = np.inf
        best = score.argmin(axis=0)
        chosen = np.argsort(score[best, np.arange(len(best))])[:each]
        knots.append(swings.knots[chosen])
        steps.append(best[chosen])
    return Guesses(np.stack(knots, axis=1), np.stack(steps, axis=1))
