"""The steps of `softarm close-gap` after the flights: the figures, put where they belong."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from softarm.diagnosis.gap.result import Diagnosis
from softarm.flights.many import Place, Reached, shares
from softarm.schemas.goals import TEST_TARGETS, Goal
from softarm.schemas.verdict import Task
from softarm.simulator.model_rows import differences
from softarm.training.run.retrain import Retrained

OLD, NEW = "old", "new"
NOMINAL, PATCHED, HELD_BACK = "nominal", "patched", "held-back"


def with_task(diagnosis: Diagnosis, flown: Mapping[tuple[str, str], Reached], is_the_robot: bool) -> Diagnosis:
    """Put the given policy's success into the verdict.

    is_the_robot: the held-back robot was declared to be the campaign's, so its flights count as real ones.
    """

    def share(key: str) -> float | None:
        return float(flown[OLD, key].mean()) if (OLD, key) in flown else None

    real = share(HELD_BACK) if is_the_robot else None
    task = Task(success_real=real, success_nominal=share(NOMINAL), success_patched=share(PATCHED))
    return replace(diagnosis, verdict=diagnosis.verdict.model_copy(update={"task": task}))


def summary(
    diagnosis: Diagnosis,
    policy: Path,
    places: Sequence[Place],
    flown: Mapping[tuple[str, str], Reached],
    retrained: Retrained | None,
    robot: str,
    spent: Mapping[str, Mapping[str, float]],
    targets: Sequence[Goal] = TEST_TARGETS,
) -> dict[str, Any]:
    """What summary.json holds; spent: step -> wall_s, cpu_s."""
    verdict = diagnosis.verdict
    patch = differences(diagnosis.nominal, diagnosis.patched) if diagnosis.nominal and diagnosis.patched else []
    success: dict[str, Any] = {}
    for place in places:
        there = [name for name in (OLD, NEW) if (name, place.key) in flown]
        success[place.key] = {name: asdict(shares(flown[name, place.key], targets)) for name in there}
        if (NEW, place.key) in flown:
            success[place.key] |= changed(flown[OLD, place.key], flown[NEW, place.key])
    return {
        "verdict": verdict.verdict,
        "effects": [effect.name for effect in verdict.effects],
        "patch": [row._asdict() for row in patch],
        "policy": str(policy),
        "held_back_robot": robot,
        "flights": len(targets) * int(next(iter(flown.values())).shape[1]) if flown else 0,
        "success": success,
        "retrained": None if retrained is None else {
            "policy": retrained.policy.name, "frames": retrained.frames, "seconds": round(retrained.seconds, 1),
            "validation_before": retrained.before, "validation_after": retrained.after, "better": retrained.better,
        },
        "spent": spent,
    }  # fmt: skip


def changed(old: Reached, new: Reached) -> dict[str, int]:
    """Flights that only the new policy reached, and those that only the old one did."""
    return {"gained": int(np.sum(new & ~old)), "lost": int(np.sum(old & ~new))}
