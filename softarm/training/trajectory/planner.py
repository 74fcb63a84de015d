"""Planner from targets and starts to simulated plans: guess, optimise, verify, try again.

Guesses are smooth random swings that pass near a target. A swing's timing has many local optima (swing once, twice, to
the right first, ...), which no gradient crosses. A batch of random swings covers them; every step of every swing is a
possible end of a plan.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from softarm.policies.plans import Plans
from softarm.schemas.model import Model
from softarm.schemas.robot import CONTROL_RATE_HZ, PHYSICS_RATE_HZ
from softarm.training.task.reach import ReachTask
from softarm.training.trajectory import problem
from softarm.training.trajectory.optimiser import Batch, Optimiser, Solution
from softarm.training.trajectory.problem import RAIL_SPARE_M, STEPS_MAX, Array, Rollouts, interpolation

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


LIBRARY = 4096  # random swings a start
TRIES = 2  # guesses a plan; the next one only if the tip passes farther from the target than CLOSE_M
CLOSE_M = 0.03
TOGETHER = 32  # plans in one batch: enough for all cores, few enough for the cache
EXTENSION_STEPS = 3  # the policy's


class Report(NamedTuple):
    """Result for each start and target, start by start."""

    plans: Plans
    planned: NDArray[np.bool_]  # [P], reached in the optimiser's own model: 240 Hz, no braking clamp, limits kept
    planned_miss_m: Array  # [P], there
    reached_s: Array  # [P], at 1200 Hz behind the clamp, within the extended horizon; NaN where it was not


class _Flown(NamedTuple):
    """Simulated results of P plans."""

    steps: NDArray[np.int64]  # [P]
    planned_miss_m: Array  # [P]
    beyond_m: Array  # [P]
    command: Array  # [P, T, 2], as sent
    tip_m: Array  # [P, T + 1, 2]
    miss_m: Array  # [P], nearest by the end of the extended horizon; infinite where the cart left its limits
    reached_s: Array  # [P], NaN where it was not

    def improve(self, which: NDArray[np.int64], other: "_Flown") -> None:
        """Replace the plans `which` by those of `other` that pass nearer to their targets."""
        nearer = other.miss_m < self.miss_m[which]
        columns: Any = zip(self, other, strict=True)
        for mine, others in columns:
            mine[which[nearer]] = others[nearer]


def plan(
    targets_m: Array,
    cart_starts_m: Sequence[float] = (0.0,),
    model: Model | None = None,
    name: str = "seed",
    seed: int = 0,
    on_advance: Callable[[float], None] = lambda share: None,
) -> Report:
    """Plan for every target [G, 2] from every start; plans come start by start, in the targets' order.

    A missed target has the nearest plan found. `name` is recorded for the model, `on_advance` receives the share of
    the plans that were just tried.
    """
    rollouts, verifier, rng = Rollouts(model), Rollouts(model, PHYSICS_RATE_HZ), np.random.default_rng(seed)
    each = [nearest(library(rollouts, start_m, LIBRARY, rng), targets_m, TRIES) for start_m in cart_starts_m]
    knots, steps = (np.concatenate(column, axis=1) for column in zip(*each, strict=True))
    target_m = np.tile(targets_m, (len(cart_starts_m), 1))
    start_m = np.repeat(np.array(cart_starts_m, dtype=np.float32), len(targets_m))

    def attempt(number: int, which: NDArray[np.int64]) -> _Flown:
        batch = Batch(target_m[which], start_m[which], steps[number, which])
        return _verify(verifier, batch, _solve(rollouts, batch, knots[number, which], on_advance))

    found = attempt(0, np.arange(len(start_m)))
    for number in range(1, TRIES):
        if (missed := np.flatnonzero(found.miss_m > CLOSE_M)).size:
            found.improve(missed, attempt(number, missed))
    plans = Plans(target_m, start_m, found.steps, found.miss_m, found.command, found.tip_m, name)
    planned = (found.planned_miss_m < ReachTask().success_radius_m) & (found.beyond_m <= RAIL_SPARE_M)
    return Report(plans, planned, found.planned_miss_m, found.reached_s)


def rows(report: Report) -> list[dict[str, Any]]:
    """Return a row of plain values per plan, start by start, with distances of the tip from the target."""
    plans = report.plans
    columns = plans.target_m, plans.cart_start_m, report.planned, report.planned_miss_m, plans.miss_m, report.reached_s
    return [
        {
            "y": round(float(target_m[0]), 6),
            "z": round(float(target_m[1]), 6),
            "start": round(float(start_m), 6),
            "planned": bool(planned),  # reached in the plan with the cart within its limit
            "planned_miss_m": float(planned_miss_m),
            "miss_m": float(miss_m),
            "reached": bool(np.isfinite(reached_s)),
            "time_s": float(reached_s) if np.isfinite(reached_s) else None,  # until it was reached
        }
        for target_m, start_m, planned, planned_miss_m, miss_m, reached_s in zip(*columns, strict=True)
    ]


def _solve(rollouts: Rollouts, batch: Batch, knots: Array, on_advance: Callable[[float], None]) -> Solution:
    """Optimise in batches of plans of like length, as a batch flies as long as its longest plan."""
    count = len(batch.steps)
    whole = Solution(knots.copy(), *np.zeros((3, count), dtype=np.float32))
    for some in _alike(batch.steps):
        solution = Optimiser(rollouts, batch.part(some)).solve(knots[some])
        whole.knots[some, : solution.knots.shape[1]] = solution.knots
        for all_plans, values in zip(whole[1:], solution[1:], strict=True):
            all_plans[some] = values
        on_advance(len(some) / count / TRIES)
    return whole


def _verify(verifier: Rollouts, batch: Batch, solution: Solution) -> _Flown:
    """Fly plans to the end of the extended horizon as the daemon would: its braking clamp, 1200 Hz."""
    task = ReachTask()
    commands = np.tensordot(interpolation(STEPS_MAX), solution.knots, (1, 1))
    step = np.arange(STEPS_MAX + EXTENSION_STEPS + 1)[:, None]
    held = commands[np.minimum(step[:-1], batch.steps - 1), np.arange(len(batch.steps))]
    motion = verifier.fly(held.astype(np.float32), batch.cart_start_m, guarded=True)
    in_time = step <= np.minimum(batch.steps + EXTENSION_STEPS, task.episode_steps)
    distance = np.where(in_time, motion.distance_m(batch.target_m, task.rail_limit_m), np.inf)
    hit = distance < task.success_radius_m
    reached_s = np.where(hit.any(axis=0), hit.argmax(axis=0) / task.rate_hz, np.nan)
    return _Flown(
        batch.steps,
        solution.miss_m,
        solution.beyond_m,
        motion.sent[:STEPS_MAX].transpose(1, 0, 2),
        motion.tip_m[: STEPS_MAX + 1].transpose(1, 0, 2),
        distance.min(axis=0),
        reached_s.astype(np.float32),
    )


def _alike(steps: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    order = np.argsort(steps, kind="stable")
    yield from np.array_split(order, -(-len(order) // TOGETHER))
