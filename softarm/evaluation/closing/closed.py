"""Results of closing a gap: the diagnosis, the policies and their flights."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

from softarm.daemon.limits.findings import RailFindings
from softarm.diagnosis.engine.result import Diagnosis
from softarm.evaluation.closing.outcomes import (
    HELD_OUT,
    MANNERS,
    NEW,
    NOMINAL,
    OLD,
    PATCHED,
    REST,
    TITLES,
    Flights,
    Paired,
    better,
    joined,
    stops_more,
)
from softarm.evaluation.closing.wires import Wires
from softarm.evaluation.runner import Robot
from softarm.schemas.goals import Goal
from softarm.schemas.verdict import Task
from softarm.training.run.retrain import Retrained


@dataclass(frozen=True)
class Place:
    """A robot to fly, with its title for people."""

    key: str  # nominal, patched, held-back
    title: str
    robot: Robot
    faults: tuple[str, ...] = ()  # of the independent robot


@dataclass(frozen=True)
class Closed:
    """Results of closing a gap, from which report and summary are made."""

    diagnosis: Diagnosis
    policy: Path  # the old one
    places: tuple[Place, ...]
    flown: Mapping[tuple[str, str, str], Flights]  # policy, place, manner
    retrained: Retrained | None  # None: no effect was named
    targets: tuple[Goal, ...]
    rail: RailFindings  # measured on the campaign's rail; its patched configuration limited all flights
    declared: bool  # the held-out robot was declared to be the campaign's robot
    wires: Wires | None = None  # None: no flights on wires

    @property
    def policies(self) -> tuple[str, ...]:
        """Names of the flown policies, of old, new and mppi."""
        return tuple(name for name in TITLES if any(policy == name for policy, *_ in self.flown))

    @property
    def flights(self) -> int:
        """Number of flights of each policy in each place, from rest or chained."""
        return int(next(iter(self.flown.values())).reached.size)

    def place(self, key: str) -> Place:
        """Return a place by its key. Raises StopIteration if no flight took place there."""
        return next(place for place in self.places if place.key == key)

    def both(self, policy: str, place: str) -> Flights:
        """Return a policy's flights from rest and chained."""
        return joined([self.flown[policy, place, manner] for manner in MANNERS])

    def won(self, place: str, new: str = NEW, old: str = OLD) -> Paired:
        """Return by how much one policy's success exceeds another's, from rest and chained together."""
        return better(self.both(old, place), self.both(new, place))

    def stops_more(self, place: str) -> Paired:
        """Return by how much the new policy's share of unrequested stops exceeds the old one's."""
        return stops_more(self.both(OLD, place), self.both(NEW, place))

    def changed(self, place: str, manner: str) -> dict[str, int]:
        """Count flights that only the new policy and only the old one reached; empty without a new one."""
        if NEW not in self.policies:
            return {}
        old, new = (self.flown[name, place, manner].reached for name in (OLD, NEW))
        return {"gained": int((new & ~old).sum()), "lost": int((old & ~new).sum())}

    def with_task(self) -> Self:
        """Put the old policy's success from rest into the verdict.

        The success on the held-out robot counts as real only if the robot was declared to be the campaign's.
        """

        def share(key: str) -> float | None:
            found = self.flown.get((OLD, key, REST))
            return None if found is None else found.share

        real = share(HELD_OUT) if self.declared else None
        task = Task(success_real=real, success_nominal=share(NOMINAL), success_patched=share(PATCHED))
        verdict = self.diagnosis.verdict.model_copy(update={"task": task})
        return replace(self, diagnosis=replace(self.diagnosis, verdict=verdict))
