"""Old, new and replanning over the same goals on every robot, from rest and chained, a process a core."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softarm.common.processes import as_they_come, cores
from softarm.daemon.shell.offline import Lockstep
from softarm.flights import many
from softarm.flights.closing.outcomes import CHAINED, REST, Flights
from softarm.flights.runner import Robot, Runner
from softarm.policies.base import Policy
from softarm.schemas import flights
from softarm.schemas.config import Config
from softarm.schemas.flights import CART_STARTS_M, Flight, Scenario, Swing
from softarm.schemas.goals import Goal
from softarm.schemas.model import Model

_PART = 9  # targets that a process takes at once; so many make a chain, too
_ORDER_SEED = 1054


@dataclass(frozen=True)
class Replanning:
    """`mppi` that plans on a model: a policy without any training."""

    model: Path

    def load(self) -> Policy:
        """Its planning is held to what it takes of a processor: other work on the machine changes no figure."""
        from softarm.policies.mppi.policy import Mppi

        return Mppi(model=str(self.model), clock=time.process_time_ns)


Flown = Path | Replanning
Key = tuple[str, str, str]  # policy, place, manner


class Job(NamedTuple):
    """What a process does at once."""

    key: Key
    policy: Flown
    robot: Robot
    scenarios: Sequence[Scenario]
    groups: Sequence[int]
    config: Config


def at_rest(targets: Sequence[Goal]) -> list[list[Scenario]]:
    """Each target from rest at each cart start, in parts."""
    grid, size = flights.grid(targets), _PART * len(CART_STARTS_M)
    return [grid[first : first + size] for first in range(0, len(grid), size)]


def chains(targets: Sequence[Goal]) -> list[list[Scenario]]:
    """Each target as often as from rest, in a mixed order that is the same every time.

    A chain's first goal finds a swung arm, each other one the arm as the goal before it left it. No target follows
    itself.
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
    tell: Callable[[str, float], None] = lambda text, share: None,
    processes: int | None = None,
) -> dict[Key, Flights]:
    """Fly the (policy, robot) pairs from rest and chained; tell(what is done, share of the work).

    The learned ones' figures are the same from any number of processes. Raises PolicyError, RuntimeError, WorkerDied.
    """
    todo = list(_jobs(policies, robots, pairs, targets, config))
    found: dict[tuple[Key, int], Flights] = {}
    whole, done, total = sum(map(_cost, todo)), 0, sum(len(job.scenarios) for job in todo)
    count = 0
    tell(f"flying {total} flights", 0.0)
    for job, flown in as_they_come(_fly, todo, processes or cores()):
        found[job.key, job.groups[0]] = flown
        done, count = done + _cost(job), count + len(job.scenarios)
        tell(f"flying, {count} of {total} flights", done / whole)
    return {key: _in_order(key, found) for key in dict.fromkeys(job.key for job in todo)}


def fly_chain(runner: Runner, chain: Iterable[Scenario]) -> list[Flight]:
    """One goal after the other; after a stop a new arm is swung about, as the next goal's scenario says."""
    daemon: Lockstep | None = None
    flown = []
    for scenario in chain:
        daemon = daemon or runner.begin(scenario)
        flown.append(daemon.pursue(scenario.goal))
        if flown[-1].stop is not None:
            daemon = None
    return flown


def _jobs(
    policies: Mapping[str, Flown],
    robots: Mapping[str, Robot],
    pairs: Iterable[tuple[str, str]],
    targets: Sequence[Goal],
    config: Config,
) -> Iterable[Job]:
    for policy, robot in pairs:
        of = (policies[policy], robots[robot])
        first = 0
        for part in at_rest(targets):
            groups = [first + number // len(CART_STARTS_M) for number in range(len(part))]
            first = groups[-1] + 1
            yield Job((policy, robot, REST), *of, part, groups, config)
        for number, chain in enumerate(chains(targets)):
            yield Job((policy, robot, CHAINED), *of, chain, [number] * len(chain), config)


def _cost(job: Job) -> int:
    """About how long a job takes, in flights of a learned policy on the simulator, some 25 ms of a core."""
    robot = 1 if isinstance(job.robot, Model) else 4
    return len(job.scenarios) * (robot + 4 * isinstance(job.policy, Replanning))


def _fly(job: Job) -> Flights:
    policy = job.policy.load() if isinstance(job.policy, Replanning) else many.load(job.policy)
    runner = Runner(policy, job.robot, job.config)
    flown = fly_chain(runner, job.scenarios) if job.key[2] == CHAINED else [runner.fly(each) for each in job.scenarios]
    reached = np.array([flight.reached for flight in flown])
    return Flights(reached, tuple(flight.stop for flight in flown), np.array(job.groups))


def _in_order(key: Key, found: Mapping[tuple[Key, int], Flights]) -> Flights:
    """A key's parts, whichever was done first."""
    parts = [found[one] for one in sorted(one for one in found if one[0] == key)]
    stops = tuple(stop for part in parts for stop in part.stops)
    together = [np.concatenate([getattr(part, name) for part in parts]) for name in ("reached", "group")]
    return Flights(together[0], stops, together[1])
