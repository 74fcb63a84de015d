"""What summary.json of `softarm close-gap` holds."""

import math
from collections.abc import Mapping
from typing import Any

from softarm.flights.closing.closed import HELD_BACK, Closed
from softarm.flights.many import shares
from softarm.simulator.model_rows import differences
from softarm.training.run.retrain import Retrained


def summary(closed: Closed, spent: Mapping[str, Mapping[str, float]]) -> dict[str, Any]:
    """Plain values. spent: step -> wall_s, cpu_s."""
    diagnosis = closed.diagnosis
    patch = differences(diagnosis.nominal, diagnosis.patched) if diagnosis.nominal and diagnosis.patched else []
    return {
        "verdict": diagnosis.verdict.verdict,
        "effects": [effect.name for effect in diagnosis.verdict.effects],
        "patch": [row._asdict() for row in patch],
        "limits": closed.rail.summary(),
        "policy": str(closed.policy),
        "held_back_robot": next(place.title for place in closed.places if place.key == HELD_BACK),
        "flights": closed.flights,
        "success": {place.key: _success(closed, place.key) for place in closed.places},
        "retrained": None if closed.retrained is None else _retrained(closed.retrained),
        "spent": spent,
    }


def _success(closed: Closed, place: str) -> dict[str, Any]:
    told: dict[str, Any] = {}
    for name in closed.policies:
        parts = shares(closed.flown[name, place], closed.targets)._asdict()
        told[name] = {part: None if math.isnan(share) else share for part, share in parts.items()}
    return told | closed.changed(place)


def _retrained(retrained: Retrained) -> dict[str, Any]:
    return {
        "policy": retrained.policy.name,
        "frames": retrained.frames,
        "seconds": round(retrained.seconds, 1),
        "validation_before": retrained.before,
        "validation_after": retrained.after,
        "better": retrained.better,
    }
