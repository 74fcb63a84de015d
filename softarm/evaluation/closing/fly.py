"""Flights of the old, the retrained and the replanning policy to the same goals, in parallel."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softarm.common.processes import as_they_come, cores
from softarm.daemon.runtime.offline import Lockstep
from softarm.evaluation.closing.outcomes import CHAINED, REST, Flights, joined
from softarm.evaluation.runner import Robot, Runner, load
from softarm.policies.base import Policy
from softarm.schemas import flights
from softarm.schemas.config import Config
from softarm.schemas.flights import CART_STARTS_M, Flight, Scenario, Swing
from softarm.schemas.goals import Goal
from softarm.schemas.model import Model

_PART = 9  # targets of one job and of one chain
_ORDER_SEED = 1054


@dataclass(frozen=True)
class Replanning:
    """The policy `mppi` planning on a model, which needs no training."""

    model: Path

    def load(self) -> Policy:
        """Return the policy, with processor time as its planning budget: other work changes no figure."""
        from softarm.policies.mppi.policy import Mppi

        return Mppi(model=str(self.model), clock=time.process_time_ns)


Flown = Path | Replanning
Key = tuple[str, str, str]  # policy, place, manner


class Job(NamedTuple):
    """Some flights of one policy on one robot, made by one process."""

    key: Key
    number: int  # among the jobs of the key
    policy: Flown
    robot: Robot
    scenarios: Sequence[Scenario]
    config: Config


def at_rest(targets: Sequence[Goal]) -> list[list[Scenario]]:
    """Return each target from rest at each cart start, in parts."""
    grid, size = flights.grid(targets), _PART * len(CART_STARTS_M)
    return [grid[first : first + size] for first in range(0, len(grid), size)]


def chains(targets: Sequence[Goal]) -> list[list[Scenario]]:
    """Return chains of goals: each target as often as from rest, in a fixed shuffled order.

    The first goal of a chain starts with a swinging arm, each later one where the previous flight ended. No target
    follows itself.
    """
    rng, parts = np.random.default_rng(_ORDER_SEED), -(-len(targets) // _PART)
    orders = [part for _ in CART_STARTS_M for part in np.array_split(rng.permutation(len(targets)), parts)]
    swings = iter(Swing.draw(number) for number in range(len(targets) * len(CART_STARTS_M)))
    return [
        [
            Scenario(targets[which], swing.cart_start_m, which, swing=swing)
            for which, swing in zip(order.tolist(), swings, strict=False)
        ]
        for order in orders
    ]


def fly_all(
    policies: Mapping[str, Flown],
    robots: Mapping[str, Robot],
    pairs: Iterable[tuple[str, str]],
    targets: Sequence[Goal],
    config: Config,
    on_progress: Callable[[str, float], None] = lambda text, share: None,
) -> dict[Key, Flights]:
    """Fly the (policy, robot) pairs from rest and chained, with the limits of `config`.

    The number of processes, one per core, does not change the figures of trained policies.

    Raises:
        PolicyError: A policy cannot be loaded.
        RuntimeError: The control loop refuses to arm.
        WorkerDied: A process ended early.
    """
    todo = [
        Job((policy, robot, manner), number, policies[policy], robots[robot], part, config)
        for policy, robot in pairs
        for manner, parts in ((REST, at_rest(targets)), (CHAINED, chains(targets)))
        for number, part in enumerate(parts)
    ]
    found: dict[tuple[Key, int], Flights] = {}
    whole, done, total = sum(map(_cost, todo)), 0, sum(len(job.scenarios) for job in todo)
    count = 0
    on_progress(f"flying {total} flights", 0.0)
    for job, flown in as_they_come(_fly, todo, cores()):
        found[job.key, job.number] = flown
        done, count = done + _cost(job), count + len(job.scenarios)
        on_progress(f"flying, {count} of {total} flights", done / whole)
    keys = dict.fromkeys(job.key for job in todo)
    return {key: joined([found[job.key, job.number] for job in todo if job.key == key]) for key in keys}


def fly_chain(runner: Runner, chain: Iterable[Scenario]) -> list[Flight]:
    """Fly one goal after the other; after a stop, continue with a new arm that swings as the next scenario says."""
    daemon: Lockstep | None = None
    flown = []
    for scenario in chain:
        daemon = daemon or runner.begin(scenario)
        flown.append(daemon.pursue(scenario.goal))
        if flown[-1].stop is not None:
            daemon = None
    return flown


def _cost(job: Job) -> int:
    """Return the estimated cost in flights of a trained policy on the simulator (about 25 ms of a core each)."""
    robot = 1 if isinstance(job.robot, Model) else 4
    return len(job.scenarios) * (robot + 4 * isinstance(job.policy, Replanning))


def _fly(job: Job) -> Flights:
    policy = job.policy.load() if isinstance(job.policy, Replanning) else load(job.policy)
    runner = Runner(policy, job.robot, job.config)
    if job.key[2] == CHAINED:
        flown, size = fly_chain(runner, job.scenarios), len(job.scenarios)
    else:
        flown, size = [runner.fly(each) for each in job.scenarios], len(CART_STARTS_M)
    reached = np.array([flight.reached for flight in flown])
    return Flights(reached, tuple(flight.stop for flight in flown), np.arange(len(flown)) // size)
