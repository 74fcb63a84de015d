"""Planner from targets and starts to simulated plans: guess, optimise, verify, choose."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from softarm.policies.plans import Plans
from softarm.schemas.model import Model
from softarm.schemas.robot import PHYSICS_RATE_HZ
from softarm.training.task.reach import ReachTask
from softarm.training.trajectory import guesses
from softarm.training.trajectory.optimiser import INNER, OUTER, Batch, Optimiser, Solution
from softarm.training.trajectory.problem import RAIL_SPARE_M, STEPS_MAX, Array, interpolation
from softarm.training.trajectory.rollout import Rollouts

Advance = Callable[[str, float], None]  # receives the current work and its share of the whole

LIBRARY = 8192  # random swings a start
EACH = 2  # guesses a target and start
TOGETHER = 32  # plans in one batch: enough for all cores, few enough for the cache
EXTENSION_STEPS = 3  # the policy's
CLOSE_M = 0.01  # below this plans count as equally near, and the cheaper one is taken


class Report(NamedTuple):
    """Result for each start and target, start by start."""

    plans: Plans
    planned: NDArray[np.bool_]  # [P], reached in the optimiser's own model: 240 Hz, no braking clamp, limits kept
    planned_miss_m: Array  # [P], there
    reached_s: Array  # [P], at 1200 Hz behind the clamp, within the extended horizon; NaN where it was not


class _Flown(NamedTuple):
    """Simulated results of P plans."""

    batch: Batch
    solution: Solution
    command: Array  # [P, T, 2], as sent
    tip_m: Array  # [P, T + 1, 2]
    miss_m: Array  # [P], nearest by the end of the extended horizon; infinite where the cart left its limits
    reached_s: Array  # [P], NaN where it was not

    def part(self, which: NDArray[np.int64]) -> "_Flown":
        solution = Solution(*(column[which] for column in self.solution))
        return _Flown(self.batch.part(which), solution, *(column[which] for column in self[2:]))


def plan(
    targets_m: Array,
    cart_starts_m: Sequence[float] = (0.0,),
    model: Model | None = None,
    name: str = "seed",
    seed: int = 0,
    on_advance: Advance = lambda doing, share: None,
) -> Report:
    """Plan for every target [G, 2] from every start; plans come start by start, in the targets' order.

    A missed target has the best plan found. `name` is recorded for the model.
    """
    planner, rng = _Planner(model), np.random.default_rng(seed)
    share = 1.0 / len(cart_starts_m)

    def advance(doing: str, part: float) -> None:
        on_advance(doing, share * part)

    found = [planner.from_start(targets_m, start, rng, advance) for start in cart_starts_m]
    batch = Batch(*_joined([each.batch for each in found]))
    solution = Solution(*_joined([each.solution for each in found]))
    command, tip, miss, reached_s = _joined([each[2:] for each in found])
    plans = Plans(batch.target_m, batch.cart_start_m, batch.steps, miss, command, tip, name)
    planned = (solution.miss_m < ReachTask().success_radius_m) & (solution.beyond_m <= RAIL_SPARE_M)
    return Report(plans, planned, solution.miss_m, reached_s)


def _joined(rows: Sequence[Sequence[Any]]) -> list[Any]:
    """Concatenate the columns of all rows."""
    return [np.concatenate(columns) for columns in zip(*rows, strict=True)]


class _Planner:
    """Planner with its simulators, for one start after another."""

    def __init__(self, model: Model | None) -> None:
        self._rollouts = Rollouts(model)
        self._verifier = Rollouts(model, PHYSICS_RATE_HZ)

    def from_start(self, targets_m: Array, start_m: float, rng: np.random.Generator, on_advance: Advance) -> _Flown:
        """Optimise several guesses per target, fly them and keep the best of each target."""
        swings = guesses.library(self._rollouts, start_m, LIBRARY, rng)
        guess = guesses.nearest(swings, targets_m, EACH)
        count = len(guess.steps)
        batch = Batch(np.repeat(targets_m, EACH, axis=0), np.full(count, start_m, dtype=np.float32), guess.steps)
        solution = self._solve(batch, guess.knots, partial(on_advance, f"{count} plans from {start_m:g} m"))
        flown = self._verify(batch, solution)
        # The cheapest plan that is near enough, else the nearest.
        score = np.maximum(flown.miss_m, CLOSE_M) + 1e-9 * solution.cost
        winner = score.reshape(-1, EACH).argmin(axis=1) + EACH * np.arange(len(targets_m))
        return flown.part(winner)

    def _solve(self, batch: Batch, knots: Array, on_advance: Callable[[float], None]) -> Solution:
        """Optimise in batches of plans of like length, as a batch flies as long as its STEPS_MAX plan."""
        count = len(batch.steps)
        whole = Solution(knots.copy(), *np.zeros((3, count), dtype=np.float32))
        for some in _alike(batch.steps):
            optimiser = Optimiser(self._rollouts, batch.part(some))
            solution = optimiser.solve(knots[some], partial(on_advance, len(some) / count / (OUTER * INNER)))
            whole.knots[some, : solution.knots.shape[1]] = solution.knots
            for all_plans, values in zip(whole[1:], solution[1:], strict=True):
                all_plans[some] = values
        return whole

    def _verify(self, batch: Batch, solution: Solution) -> _Flown:
        """Fly plans to the end of the extended horizon as the daemon would: its braking clamp, 1200 Hz."""
        task = ReachTask()
        commands = np.einsum("tk,pkc->tpc", interpolation(STEPS_MAX), solution.knots)
        step = np.arange(STEPS_MAX + EXTENSION_STEPS + 1)[:, None]
        held = commands[np.minimum(step[:-1], batch.steps - 1), np.arange(len(batch.steps))]
        motion = self._verifier.fly(held.astype(np.float32), batch.cart_start_m, guarded=True)
        in_time = step <= np.minimum(batch.steps + EXTENSION_STEPS, task.episode_steps)
        distance = np.where(in_time, motion.distance_m(batch.target_m, task.rail_limit_m), np.inf)
        hit = distance < task.success_radius_m
        reached_s = np.where(hit.any(axis=0), hit.argmax(axis=0) / task.rate_hz, np.nan)
        return _Flown(
            batch,
            solution,
            motion.sent[:STEPS_MAX].transpose(1, 0, 2),
            motion.tip_m[: STEPS_MAX + 1].transpose(1, 0, 2),
            distance.min(axis=0),
            reached_s.astype(np.float32),
        )


def _alike(steps: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    order = np.argsort(steps, kind="stable")
    yield from np.array_split(order, -(-len(order) // TOGETHER))
