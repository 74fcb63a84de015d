"""Policies over the 54 test targets on several robots, the daemon's own tick in all of them, a process a core."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softarm.common.processes import as_they_come, cores
from softarm.flights import runner as trials
from softarm.policies import registry
from softarm.reality.parameters import GROUPS, RobotParameters
from softarm.schemas.config import Policy as ConfiguredPolicy
from softarm.schemas.goals import TEST_TARGETS, TRAINED_Z_MAX_M, Goal
from softarm.schemas.model import Model

Reached = NDArray[np.bool_]  # [targets, starts]
_PART = 9  # targets that a process takes at once


@dataclass(frozen=True)
class Place:
    """A robot to fly on: the simulator with a model, or, with `parameters`, the independent robot."""

    key: str  # nominal, patched, held-back
    title: str
    model: Model | None = None
    parameters: RobotParameters | None = None


@dataclass(frozen=True)
class Shares:
    """Of the flights, how many reached their target."""

    in_range: float | None  # z <= 0.70 m; None without such targets
    above: float | None
    all: float


def shares(reached: Reached, targets: Sequence[Goal] = TEST_TARGETS) -> Shares:
    """Shares by where the targets lie; reached is [targets, starts]."""
    inside = np.array([goal.z_m <= TRAINED_Z_MAX_M for goal in targets])
    parts = [float(reached[rows].mean()) if rows.any() else None for rows in (inside, ~inside)]
    return Shares(parts[0], parts[1], float(reached.mean()))


def fly(policy: Path | str, place: Place, targets: Sequence[Goal] = TEST_TARGETS) -> Reached:
    """Fly every target from rest at every cart start; policy: an ONNX file, or a name that the registry knows.

    Raises PolicyError for what is no policy.
    """
    if isinstance(policy, str):
        plugin = registry.load(policy)
    else:
        plugin = registry.load("flown", {"flown": ConfiguredPolicy(plugin="onnx", options={"model": str(policy)})})
    wanted = trials.grid_trials(targets)
    if place.parameters is None:
        flown = trials.fly(plugin, place.model, wanted)
    else:
        flown = trials.fly_held_back(plugin, place.parameters, wanted)
    return np.array([outcome.reached for outcome in flown]).reshape(len(targets), -1)


def fly_all(
    policies: Mapping[str, Path | str],
    places: Sequence[Place],
    targets: Sequence[Goal] = TEST_TARGETS,
    on_flights: Callable[[int], None] = lambda flights: None,
    processes: int | None = None,
) -> dict[tuple[str, str], Reached]:
    """(policy's name, place's key) -> reached, [targets, starts]. on_flights(how many more are done).

    The same figures from any number of processes; none is started for 1. Raises what `fly` raises.
    """
    parts = [targets[i : i + _PART] for i in range(0, len(targets), _PART)]
    jobs = [(name, place, i) for place in places for name in policies for i in range(len(parts))]
    found: dict[tuple[str, str, int], Reached] = {}
    for job, reached in as_they_come(partial(_fly, policies, parts), jobs, processes or cores()):
        name, place, i = job
        found[name, place.key, i] = reached
        on_flights(reached.size)
    return {
        (name, place.key): np.concatenate([found[name, place.key, i] for i in range(len(parts))])
        for place in places
        for name in policies
    }


def _fly(policies: Mapping[str, Path | str], parts: Sequence[Sequence[Goal]], job: tuple[str, Place, int]) -> Reached:
    name, place, i = job
    return fly(policies[name], place, parts[i])


def with_faults(robot: RobotParameters, faults: Sequence[str]) -> RobotParameters:
    """Give the independent robot its faults, `group.quantity=value` each (docs/reality.md lists them).

    Raises ValueError for one that there is none of, or whose value is out of bounds.
    """
    for text in faults:
        key, equals, number = text.partition("=")
        group, _, name = key.strip().partition(".")
        part = getattr(robot, group, None) if type(getattr(robot, group, None)) in GROUPS else None
        known = part.__dataclass_fields__ if part is not None else {}
        if not equals or part is None or name not in known:
            groups = [g for g in robot.__dataclass_fields__ if type(getattr(robot, g)) in GROUPS]
            allowed = ", ".join(known) if part is not None else f"a group of {', '.join(groups)}"
            raise ValueError(f"--fault {text}: write group.quantity=value, such as regulator.dead_time_s=0.06; "
                             f"allowed here: {allowed}")  # fmt: skip
        try:
            value = int(number) if known[name].type in (int, "int") else float(number)
        except ValueError:
            raise ValueError(f"--fault {text}: '{number}' is no number; give one") from None
        robot = replace(robot, **{group: replace(part, **{name: value})})
    return robot
