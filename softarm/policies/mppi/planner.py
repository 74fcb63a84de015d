"""Search over a population of plans that are simulated, sorted and varied, without clock and I/O.

A plan has one command per control step, each in -1 .. 1: float32 [2, T, N], cart velocity then pressure.
"""

from typing import TYPE_CHECKING

import numpy as np

from softarm.policies.base import HIGH, LOW, Array
from softarm.schemas.config import RailLimits
from softarm.schemas.model import Model

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


if TYPE_CHECKING:
    from softarm.simulator.simulator import Simulator

PHYSICS_HZ = 120.0  # coarse: the next tick corrects the error of some mm at a plan's end
KEPT_SHARE = 1 / 8  # of a round's plans, varied in the next round
FRESH_SHARE = 1 / 8  # of a tick's first round, new random plans
CENTRE, HALF = np.float32(0.5) * (HIGH + LOW), np.float32(0.5) * (HIGH - LOW)


class Planner:
    """Search for plans of `steps` commands, `period_s` apart; each round simulates `rollouts` plans on `model`."""

    def __init__(self, model: Model, rollouts: int, steps: int, period_s: float) -> None:
        from softarm.simulator.simulator import Simulator  # imports numba, which only this policy needs

        self.simulator: Simulator = Simulator(model, robots=rollouts, physics_rate_hz=PHYSICS_HZ)
        self._rollouts, self._steps, self._period_s = rollouts, steps, period_s
        self._kept = round(KEPT_SHARE * rollouts)
        self.begin(np.zeros(2, dtype=np.float32), seed=0)

    def begin(self, command: Array, seed: int) -> None:
        """Start with a single plan: to hold `command` [cart velocity (m/s), pressure (kPa)]."""
        self._random = np.random.default_rng(seed)
        held = np.clip((command - CENTRE) / HALF, -1.0, 1.0)
        self._plans = np.broadcast_to(held[:, None, None], (2, self._steps, 1)).astype(np.float32)
        self._fresh = self._rollouts // 2
        self.cost = np.inf

    def move_on(self) -> None:
        """Remove the first command of every plan after a control step; the last one is held."""
        self._plans = np.concatenate((self._plans[:, 1:], self._plans[:, -1:]), axis=1)
        self._fresh = int(FRESH_SHARE * self._rollouts)

    def improve(self, robot: "Simulator", target_m: Array) -> None:
        """Run one round: vary the kept plans, simulate all from the state of robot 0 of `robot`, keep the best.

        The kept plans fly again, so a round never loses its best plan. `target_m` is y and z, [2].
        """
        new = self._rollouts - self._plans.shape[2] - self._fresh
        parts = [self._plans, variations(self._random, self._plans, new)]
        if self._fresh:
            parts.append(swings(self._random, self._steps, self._fresh, self._period_s))
            self._fresh = 0
        flown = np.concatenate(parts, axis=2)
        self.simulator.take_over(robot)
        velocity, pressure = (HALF[i] * flown[i] + CENTRE[i] for i in (0, 1))
        path = self.simulator.fly(velocity, pressure, self._period_s)
        costs = cost(path, target_m, self._period_s)
        best = np.argsort(costs, kind="stable")[: self._kept]
        self._plans, self.cost = flown[:, :, best], float(costs[best[0]])

    def best(self) -> Array:
        """Return the best plan, float32 [T, 2]: cart velocity (m/s), pressure (kPa)."""
        plan: Array = CENTRE + HALF * self._plans[:, :, 0].T
        return plan
