"""What came of closing a gap: the diagnosis, the policies and where each of them reached."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from softarm.daemon.limits.findings import RailFindings
from softarm.diagnosis.engine.result import Diagnosis
from softarm.flights.many import Flown
from softarm.flights.runner import Robot
from softarm.schemas.goals import Goal
from softarm.schemas.verdict import Task
from softarm.training.run.retrain import Retrained

OLD, NEW = "old", "new"
NOMINAL, PATCHED, HELD_BACK = "nominal", "patched", "held-back"


@dataclass(frozen=True)
class Place:
    """A robot to fly on, and what people call it."""

    key: str  # nominal, patched, held-back
    title: str
    robot: Robot


@dataclass(frozen=True)
class Closed:
    """Frozen values; summary and story tell them."""

    diagnosis: Diagnosis
    policy: Path  # the old one
    places: tuple[Place, ...]
    flown: Flown  # OLD or NEW, a place's key
    retrained: Retrained | None  # None: nothing was named
    targets: tuple[Goal, ...]
    rail: RailFindings  # what the campaign shows of the rail; its patched configuration is what was flown by

    @property
    def policies(self) -> tuple[str, ...]:
        """Which of old and new were flown."""
        return tuple(name for name in (OLD, NEW) if any(policy == name for policy, _ in self.flown))

    @property
    def flights(self) -> int:
        """Of each policy in each place."""
        return int(next(iter(self.flown.values())).size)

    def changed(self, place: str) -> dict[str, int]:
        """Flights that only the new policy reached there, and that only the old one did; nothing without a new one."""
        if NEW not in self.policies:
            return {}
        old, new = self.flown[OLD, place], self.flown[NEW, place]
        return {"gained": int(np.sum(new & ~old)), "lost": int(np.sum(old & ~new))}

    def with_task(self, is_the_robot: bool) -> Self:
        """Put the old policy's success into the verdict; the held-back robot's as real if it was declared to be so."""

        def share(key: str) -> float | None:
            return float(self.flown[OLD, key].mean()) if (OLD, key) in self.flown else None

        real = share(HELD_BACK) if is_the_robot else None
        task = Task(success_real=real, success_nominal=share(NOMINAL), success_patched=share(PATCHED))
        verdict = self.diagnosis.verdict.model_copy(update={"task": task})
        return replace(self, diagnosis=replace(self.diagnosis, verdict=verdict))
