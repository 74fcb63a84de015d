"""Policies over the 54 test targets on several robots, a process a core."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from softarm.common.processes import as_they_come, cores
from softarm.flights.runner import Robot, fly
from softarm.policies import registry
from softarm.policies.base import Policy
from softarm.schemas import flights
from softarm.schemas.config import Config
from softarm.schemas.config import Policy as ConfiguredPolicy
from softarm.schemas.flights import TEST_TARGETS, Shares
from softarm.schemas.goals import Goal

Reached = NDArray[np.bool_]  # [targets, starts]
PolicyName = Path | str  # an ONNX file, or a name that the registry knows
_PART = 9  # targets that a process takes at once


class Job(NamedTuple):
    """What a process does at once."""

    policy: str
    robot: str
    first: int  # of the targets
    flown: PolicyName
    on: Robot
    targets: Sequence[Goal]
    config: Config | None


def load(policy: PolicyName) -> Policy:
    """A policy to fly. Raises PolicyError for what is none."""
    if isinstance(policy, str):
        return registry.load(policy)
    return registry.load("flown", {"flown": ConfiguredPolicy(plugin="onnx", options={"model": str(policy)})})


def fly_grid(
    policy: PolicyName, robot: Robot, targets: Sequence[Goal] = TEST_TARGETS, config: Config | None = None
) -> Reached:
    """Fly every target from rest at every cart start. Raises PolicyError for what is no policy."""
    flown = fly(load(policy), robot, flights.grid(targets), config)
    return np.array([flight.reached for flight in flown]).reshape(len(targets), -1)


def fly_all(
    policies: Mapping[str, PolicyName],
    robots: Mapping[str, Robot],
    targets: Sequence[Goal] = TEST_TARGETS,
    on_flights: Callable[[int], None] = lambda flights: None,
    processes: int | None = None,
    config: Config | None = None,
) -> dict[tuple[str, str], Reached]:
    """Every policy on every robot, by the daemon's configuration. on_flights(how many more are done).

    The same figures from any number of processes (default: one a core); none is started for 1. Raises what `fly_grid`
    raises, and WorkerDied.
    """
    firsts = range(0, len(targets), _PART)
    jobs = [
        Job(policy, robot, first, policies[policy], robots[robot], targets[first : first + _PART], config)
        for robot in robots
        for policy in policies
        for first in firsts
    ]
    found: dict[tuple[str, str, int], Reached] = {}
    for job, reached in as_they_come(_fly, jobs, processes or cores()):
        found[job.policy, job.robot, job.first] = reached
        on_flights(reached.size)
    return {
        (policy, robot): np.concatenate([found[policy, robot, first] for first in firsts])
        for robot in robots
        for policy in policies
    }


def shares(reached: Reached, targets: Sequence[Goal] = TEST_TARGETS) -> Shares:
    """Shares by where the targets lie; reached is [targets, starts]."""
    heights_m = np.repeat([goal.z_m for goal in targets], reached.shape[1])
    return flights.shares(reached.ravel(), heights_m)


def _fly(job: Job) -> Reached:
    return fly_grid(job.flown, job.on, job.targets, job.config)
