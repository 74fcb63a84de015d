"""Ceiling of success: a cross-entropy search over open-loop commands, which gives a lower bound.

The search uses only the tip's smallest distance, no gradients, costs or references. It shares simulator and braking
clamp with planners and policies, so a target that all of them miss is likely out of reach.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from softarm.schemas.config import RailLimits
from softarm.schemas.model import Model
from softarm.schemas.robot import PRESSURE_MAX_KPA, PRESSURE_MIN_KPA
from softarm.training.task.reach import ReachTask
from softarm.training.trajectory.problem import Array, interpolation
from softarm.training.trajectory.rollout import Rollouts

POPULATION, ELITES, ROUNDS = 96, 12, 40
SMOOTH = 0.15  # share of the old mean and spread that a round keeps
SPREAD_LEAST = 0.02  # of the range, so that the population keeps searching


class Bounds(NamedTuple):
    """Limits of a search; by default those of the robot."""

    limits: RailLimits = RailLimits()
    pressure_max_kpa: float = PRESSURE_MAX_KPA
    guarded: bool = True  # whether the braking clamp acts


class Ceiling(NamedTuple):
    """Best result of the search, one entry per target."""

    closest_m: Array  # [G]
    reached_s: Array  # [G], time of the smallest distance; NaN for a missed target


def search(
    targets_m: Array,
    cart_start_m: float = 0.0,
    model: Model | None = None,
    seed: int = 0,
    on_round: Callable[[], None] = lambda: None,
    bounds: Bounds | None = None,
) -> Ceiling:
    """Search commands for every target [G, 2] from a straight, vented arm at rest; at the actuators' full ranges."""
    bounds = bounds or Bounds()
    task, rng = ReachTask(), np.random.default_rng(seed)
    targets, steps = len(targets_m), task.episode_steps
    spread_out = interpolation(steps)
    knots = spread_out.shape[1]
    rollouts = Rollouts(model, limits=bounds.limits)
    # Unit commands: -1 .. 1 is the actuators' range.
    mean = np.zeros((targets, knots, 2), dtype=np.float32)
    spread = np.full_like(mean, 0.7)
    wanted = np.repeat(targets_m, POPULATION, axis=0)
    closest, when = np.full(targets, np.inf, dtype=np.float32), np.zeros(targets)
    best = mean.copy()
    for _ in range(ROUNDS):
        noise = rng.standard_normal((targets, POPULATION, knots, 2), dtype=np.float32)
        tried = np.clip(mean[:, None] + spread[:, None] * noise, -1.0, 1.0)
        tried[:, 0] = best
        near, step = _fly(rollouts, bounds, spread_out, tried.reshape(-1, knots, 2), wanted, cart_start_m)
        near, step = near.reshape(targets, POPULATION), step.reshape(targets, POPULATION)
        order = near.argsort(axis=1)[:, :ELITES]
        elite = np.take_along_axis(tried, order[..., None, None], axis=1)
        mean = SMOOTH * mean + (1 - SMOOTH) * elite.mean(axis=1)
        spread = np.maximum(SMOOTH * spread + (1 - SMOOTH) * elite.std(axis=1), SPREAD_LEAST)
        first, everyone = order[:, 0], np.arange(targets)
        better = near[everyone, first] < closest
        closest = np.where(better, near[everyone, first], closest)
        when = np.where(better, step[everyone, first], when)
        best = np.where(better[:, None, None], elite[:, 0], best)
        on_round()
    reached_s = np.where(closest < task.success_radius_m, when / task.rate_hz, np.nan)
    return Ceiling(closest, reached_s.astype(np.float32))


def _fly(
    rollouts: Rollouts, bounds: Bounds, spread_out: Array, knots: Array, targets_m: Array, cart_start_m: float
) -> tuple[Array, NDArray[np.int64]]:
    """Return each robot's smallest distance with its cart inside the limit, and the step of it, [R]."""
    high = np.array((bounds.limits.velocity_max_m_s, bounds.pressure_max_kpa), dtype=np.float32)
    low = np.array((-high[0], PRESSURE_MIN_KPA), dtype=np.float32)
    commands = low + (np.tensordot(spread_out, knots, (1, 1)) + 1.0) * (0.5 * (high - low))
    start = np.full(len(knots), cart_start_m, dtype=np.float32)
    motion = rollouts.fly(commands.astype(np.float32), start, guarded=bounds.guarded)
    distance = motion.distance_m(targets_m, bounds.limits.position_max_m)
    return distance.min(axis=0), distance.argmin(axis=0)
