"""Planner from targets and starts to simulated plans: guess, optimise, verify, try again."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from softarm.policies.plans import Plans
from softarm.schemas.model import Model
from softarm.schemas.robot import PHYSICS_RATE_HZ
from softarm.training.task.reach import ReachTask
from softarm.training.trajectory.guesses import library, nearest
from softarm.training.trajectory.optimiser import Batch, Optimiser, Solution
from softarm.training.trajectory.problem import RAIL_SPARE_M, STEPS_MAX, Array, interpolation
from softarm.training.trajectory.rollout import Rollouts

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
