"""What came of closing a gap: the diagnosis, the policies and where each of them reached."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Self

from softarm.daemon.limits.findings import RailFindings
from softarm.diagnosis.engine.result import Diagnosis
from softarm.flights.closing.advice import Advice, advise
from softarm.flights.closing.outcomes import (
    HELD_BACK,
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
from softarm.flights.closing.wires import Wires
from softarm.flights.runner import Robot
from softarm.schemas.goals import Goal
from softarm.schemas.verdict import Task
from softarm.training.run.retrain import Retrained


@dataclass(frozen=True)
class Place:
    """A robot to fly on, and what people call it."""

    key: str  # nominal, patched, held-back
    title: str
    robot: Robot
    faults: tuple[str, ...] = ()  # of the independent robot


@dataclass(frozen=True)
class Closed:
    """Frozen values; summary and story tell them."""

    diagnosis: Diagnosis
    policy: Path  # the old one
    places: tuple[Place, ...]
    flown: Mapping[tuple[str, str, str], Flights]  # policy, place, manner
    retrained: Retrained | None  # None: nothing was named
    targets: tuple[Goal, ...]
    rail: RailFindings  # what the campaign shows of the rail; its patched configuration is what was flown by
    declared: bool  # the held-back robot was said to be the campaign's own
    wires: Wires | None = None  # None: nothing was flown through wires

    @property
    def policies(self) -> tuple[str, ...]:
        """Which of old, new and mppi were flown."""
        return tuple(name for name in TITLES if any(policy == name for policy, *_ in self.flown))

    @property
    def flights(self) -> int:
        """Of each policy in each place, by manner."""
        return int(next(iter(self.flown.values())).reached.size)

    def place(self, key: str) -> Place:
        """By its key; StopIteration for one that was not flown on."""
        return next(place for place in self.places if place.key == key)

    def both(self, policy: str, place: str) -> Flights:
        """A policy's flights from rest and chained."""
        return joined([self.flown[policy, place, manner] for manner in MANNERS])

    def won(self, place: str, new: str = NEW, old: str = OLD) -> Paired:
        """How much more often one policy reached there than another, from rest and chained together."""
        return better(self.both(old, place), self.both(new, place))

    def stops_more(self, place: str) -> Paired:
        """How much more often the new policy's arm stopped there, unasked."""
        return stops_more(self.both(OLD, place), self.both(NEW, place))

    def changed(self, place: str, manner: str) -> dict[str, int]:
        """Flights that only the new policy reached there, and that only the old one did; nothing without a new one."""
        if NEW not in self.policies:
            return {}
        old, new = (self.flown[name, place, manner].reached for name in (OLD, NEW))
        return {"gained": int((new & ~old).sum()), "lost": int((old & ~new).sum())}

    @cached_property
    def advice(self) -> Advice:
        """Which policy to fly, and why not the new one."""
        return advise(self)

    def with_task(self) -> Self:
        """Put the old policy's success from rest into the verdict; the held-back robot's as real if it was declared."""

        def share(key: str) -> float | None:
            found = self.flown.get((OLD, key, REST))
            return None if found is None else found.share

        real = share(HELD_BACK) if self.declared else None
        task = Task(success_real=real, success_nominal=share(NOMINAL), success_patched=share(PATCHED))
        verdict = self.diagnosis.verdict.model_copy(update={"task": task})
        return replace(self, diagnosis=replace(self.diagnosis, verdict=verdict))
