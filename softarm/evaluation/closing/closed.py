"""Results of closing a gap: the diagnosis, the policies and their flights, and the recommended policy."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from softarm.daemon.limits.findings import RailFindings
from softarm.diagnosis.engine.result import Diagnosis
from softarm.evaluation.closing.fly import draw
from softarm.evaluation.closing.outcomes import (
    ADAPTIVE,
    HELD_OUT,
    NEW,
    NOMINAL,
    OLD,
    PATCHED,
    REST,
    TITLES,
    Flights,
    Paired,
    better,
    stops_more,
)
from softarm.evaluation.closing.wires import Wires
from softarm.evaluation.runner import Robot
from softarm.reporting.numbers import percent
from softarm.schemas.goals import Goal
from softarm.schemas.verdict import Task
from softarm.training.run.retrain import Retrained

Spent = dict[str, dict[str, float]]  # step -> wall_s, cpu_s


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
    judged: Place  # the robot on which the ways are compared
    flown: Mapping[tuple[str, str], Flights]  # policy, place; flight k is draw k
    retrained: Retrained | None  # None: no effect was named
    rail: RailFindings  # measured on the campaign's rail; its patched configuration limited all flights
    spent: Spent
    wires: Wires | None = None  # None: no flights on wires

    @property
    def ways(self) -> tuple[str, ...]:
        """Names of the policies that were compared with the old one."""
        return tuple(name for name in TITLES if name != OLD and (name, self.judged.key) in self.flown)

    def place(self, key: str) -> Place:
        """Return a place by its key. Raises StopIteration if no flight took place there."""
        return next(place for place in self.places if place.key == key)

    def of(self, policy: str, manner: str) -> Flights:
        """Return a policy's flights on the judging robot that began at rest or in mid-swing."""
        flown = self.flown[policy, self.judged.key]
        rest = np.array([draw(number).swing is None for number in range(flown.reached.size)], dtype=np.bool_)
        return flown.chosen(rest if manner == REST else ~rest)

    def goals(self, policy: str) -> list[Goal]:
        """Return the goals of a policy's flights on the judging robot."""
        return [draw(number).goal for number in range(self.flown[policy, self.judged.key].reached.size)]

    def won(self, name: str) -> Paired:
        """Return by how much a policy's success exceeds the old one's on the judging robot."""
        return better(*self._pair(name))

    def stops_more(self, name: str) -> Paired:
        """Return by how much a policy's share of unrequested stops exceeds the old one's."""
        return stops_more(*self._pair(name))

    def seconds(self, name: str) -> tuple[float, float]:
        """Return the wall and processor seconds until a policy can fly, its flights of the comparison included."""
        steps = {NEW: ("retrain", NEW)}.get(name, (name,)) + (() if name in (OLD, ADAPTIVE) else ("diagnose",))
        taken = [self.spent[step] for step in steps if step in self.spent]
        return sum(each["wall_s"] for each in taken), sum(each["cpu_s"] for each in taken)

    def with_task(self) -> Self:
        """Put the old policy's success into the verdict, in simulation and, if it was declared, on the robot."""

        def share(key: str) -> float | None:
            found = self.flown.get((OLD, key))
            return None if found is None or not found.reached.size else found.share

        task = Task(success_real=share(HELD_OUT), success_nominal=share(NOMINAL), success_patched=share(PATCHED))
        verdict = self.diagnosis.verdict.model_copy(update={"task": task})
        return replace(self, diagnosis=replace(self.diagnosis, verdict=verdict))

    def _pair(self, name: str) -> tuple[Flights, Flights]:
        old, new = (self.flown[each, self.judged.key] for each in (OLD, name))
        return old.chosen(slice(new.reached.size)), new


@dataclass(frozen=True)
class Advice:
    """The policy to fly, and the reasons against each other way."""

    fly: str  # old, mppi, new, adaptive
    against: Mapping[str, tuple[str, ...]]


def advise(closed: Closed) -> Advice:
    """Recommend the way with the largest gain among those that are shown to be better, or the old policy.

    A way must be significantly better on the judging robot, and stop no more often there. The retrained policy must
    also be better in validation and not worse on the wires; on them it may show its gain too. Significant: the
    always-valid 95 % interval excludes 0.
    """
    against = {name: tuple(_against(closed, name)) for name in closed.ways}
    good = [name for name, reasons in against.items() if not reasons]
    return Advice(max(good, key=lambda name: closed.won(name).value, default=OLD), against)


def _against(closed: Closed, name: str) -> list[str]:
    """Return the reasons against a way."""
    won, found = closed.won(name), []
    wires = closed.wires if name == NEW else None
    proven = wires is not None and wires.is_the_robot and wires.won is not None and wires.won.above
    if won.below or not (won.above or (proven and won.value >= 0.0)):
        how = "worse" if won.below else "not significantly better" if won.value > 0.0 else "no better"
        draws = closed.flown[name, closed.judged.key].reached.size
        found.append(f"on {closed.judged.title} it is {how}: {won.text} of {draws} flights")
    if closed.stops_more(name).above:
        old, new = (int(closed.flown[each, closed.judged.key].stopped.sum()) for each in (OLD, name))
        found.append(f"on {closed.judged.title} it causes more unrequested stops: {new}, not {old}")
    if name == NEW and closed.retrained is not None and not closed.retrained.better:
        before, after = percent(closed.retrained.before), percent(closed.retrained.after)
        found.append(f"in validation it is no better: {before} before, {after} after")
    return found + list(wires.against if wires is not None else ())
