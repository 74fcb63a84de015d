"""Flights of two policies to the same draws, in parallel, until the decision between them is clear."""

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softarm.common.processes import as_they_come, cores
from softarm.evaluation.closing.outcomes import Flights, joined, settled
from softarm.evaluation.runner import Robot, Runner, load
from softarm.policies.base import Policy
from softarm.schemas.config import Config
from softarm.schemas.flights import CART_STARTS_M, TEST_TARGETS, Scenario, Swing

PART = 6  # draws of one job
MOST = 324  # draws of a comparison that stays unclear
SLOWER = 3  # a replanning policy flies that part of the draws: each takes several times as long
_SEED = 1054
NONE = joined(())


@dataclass(frozen=True)
class Replanning:
    """The policy `mppi` planning on a model, which needs no training."""

    model: Path

    def load(self) -> Policy:
        """Return the policy, with processor time as its planning budget: other work changes no figure."""
        from softarm.policies.mppi.policy import Mppi

        return Mppi(model=str(self.model), clock=time.process_time_ns)


Flown = Path | Replanning


class Job(NamedTuple):
    """Some draws flown with one policy on one robot, by one process."""

    is_new: bool
    part: int
    policy: Flown
    robot: Robot
    config: Config


def draw(number: int) -> Scenario:
    """Return a scenario of the paper's 54 targets; the same number gives the same scenario.

    Draws are independent. One half starts at rest at one of the test's cart positions, the other half in mid-swing.
    """
    rng = np.random.default_rng((_SEED, number))
    goal = TEST_TARGETS[rng.integers(len(TEST_TARGETS))]
    if rng.random() < 0.5:
        return Scenario(goal, float(rng.choice(CART_STARTS_M)), number)
    swing = Swing.draw(number)
    return Scenario(goal, swing.cart_start_m, number, swing=swing)


def most(policy: Flown, wanted: int) -> int:
    """Return the largest number of draws of a policy, in whole jobs."""
    draws = wanted // SLOWER if isinstance(policy, Replanning) else wanted
    return -(-draws // PART) * PART


def compare(
    old: Flown,
    new: Flown,
    robot: Robot,
    config: Config,
    wanted: int,
    known: Flights = NONE,
    on_progress: Callable[[int, float], None] = lambda draws, share: None,
) -> tuple[Flights, Flights]:
    """Fly both policies to the same draws until `outcomes.settled`, or `wanted` draws.

    The result does not depend on the number of processes.

    Args:
        known: Flights of the old policy to the first draws, which are not repeated.
        on_progress: Called with the number of draws and the share of the largest number.

    Returns:
        The flights of the old policy, with all known ones, and of the new one.

    Raises:
        PolicyError: A policy cannot be loaded.
        RuntimeError: The control loop refuses to arm.
        WorkerDied: A process ended early.
    """
    parts = most(new, wanted) // PART
    first = known.reached.size // PART
    jobs = [
        Job(is_new, part, new if is_new else old, robot, config)
        for part in range(parts)
        for is_new in (False, True)
        if is_new or part >= first
    ]
    found = {(False, part): known.chosen(slice(part * PART, (part + 1) * PART)) for part in range(first)}
    both = NONE, NONE
    with closing(as_they_come(_fly, jobs, cores())) as results:
        for pair in _in_order(results, found):
            both = joined([both[0], pair[0]]), joined([both[1], pair[1]])
            draws = both[1].reached.size
            on_progress(draws, draws / (parts * PART))
            if settled(*both):
                break
    return (both[0] if both[0].reached.size > known.reached.size else known), both[1]


def _in_order(
    results: Iterable[tuple[Job, Flights]], found: dict[tuple[bool, int], Flights]
) -> Iterator[tuple[Flights, Flights]]:
    """Yield the flights of old and new policy part by part, as soon as both have flown a part."""
    number = 0
    for job, flown in results:
        found[job.is_new, job.part] = flown
        while (False, number) in found and (True, number) in found:
            yield found[False, number], found[True, number]
            number += 1


def fly(policy: Flown, robot: Robot, config: Config, draws: int) -> Flights:
    """Fly a policy to the first draws, in whole jobs; errors as for `compare`."""
    jobs = [Job(False, part, policy, robot, config) for part in range(most(policy, draws) // PART)]
    found = {job.part: flown for job, flown in as_they_come(_fly, jobs, cores())}
    return joined([found[part] for part in sorted(found)])


def _fly(job: Job) -> Flights:
    runner = Runner(_loaded(job.policy), job.robot, job.config)
    flown = [runner.fly(draw(job.part * PART + number)) for number in range(PART)]
    reached = np.array([flight.reached for flight in flown])
    return Flights(reached, tuple(flight.stop for flight in flown), np.arange(PART))


@lru_cache(maxsize=2)
def _loaded(policy: Flown) -> Policy:
    """Return a policy that has been loaded once in this process; the planner's compilation takes a second."""
    return policy.load() if isinstance(policy, Replanning) else load(policy)
