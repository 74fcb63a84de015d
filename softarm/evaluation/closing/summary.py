"""Content of summary.json, written by `softarm close-gap`."""

import math
from collections.abc import Mapping
from typing import Any

from softarm.evaluation.closing.advice import advise
from softarm.evaluation.closing.closed import Closed
from softarm.evaluation.closing.outcomes import HELD_OUT, MANNERS, NEW, OLD, PATCHED, REPLANNED, REST, Flights, better
from softarm.evaluation.closing.wires import Wires
from softarm.schemas import flights
from softarm.simulator.model_rows import differences
from softarm.training.run.retrain import Retrained


def summary(closed: Closed, spent: Mapping[str, Mapping[str, float]]) -> dict[str, Any]:
    """Return the results as plain values; `spent` maps each step to its wall_s and cpu_s."""
    diagnosis, advice = closed.diagnosis, advise(closed)
    patch = differences(diagnosis.nominal, diagnosis.patched) if diagnosis.nominal and diagnosis.patched else []
    return {
        "verdict": diagnosis.verdict.verdict,
        "effects": [effect.name for effect in diagnosis.verdict.effects],
        "patch": [row._asdict() for row in patch],
        "limits": closed.rail.summary(),
        "policy": str(closed.policy),
        "held_back_robot": closed.place(HELD_OUT).title,
        "flights": closed.flights,
        "success": {place.key: _success(closed, place.key) for place in closed.places},
        "fly": advice.fly,
        "against_retrained": list(advice.against),
        "mppi_beyond_advised": _replanning(closed),
        "wires": None if closed.wires is None else _wires(closed.wires),
        "retrained": None if closed.retrained is None else _retrained(closed.retrained),
        "spent": spent,
    }


def _success(closed: Closed, place: str) -> dict[str, Any]:
    """Return success by policy, from rest also by height, and the differences between old and new."""
    success: dict[str, Any] = {}
    for name in closed.policies:
        if (name, place, REST) not in closed.flown:
            continue
        success[name] = {manner: _flights(closed.flown[name, place, manner]) for manner in MANNERS}
        heights_m = flights.heights(flights.grid(closed.targets))
        parts = flights.shares(closed.flown[name, place, REST].reached, heights_m)._asdict()
        success[name] |= {part: None if math.isnan(share) else share for part, share in parts.items()}
    if NEW in success:
        for manner in MANNERS:
            old, new = closed.flown[OLD, place, manner], closed.flown[NEW, place, manner]
            success[manner] = {**closed.changed(place, manner), "difference": better(old, new)._asdict()}
        success["difference"] = closed.won(place)._asdict()
        success["stops_difference"] = closed.stops_more(place)._asdict()
    return success


def _flights(flown: Flights) -> dict[str, Any]:
    stops = [stop for stop in flown.stops if stop is not None]
    return {
        "flights": int(flown.reached.size),
        "reached": int(flown.reached.sum()),
        "stops": {why: stops.count(why) for why in dict.fromkeys(stops)},
    }


def _wires(wires: Wires) -> dict[str, Any]:
    return {
        "flown_on": wires.title,
        "is_the_robot": wires.is_the_robot,
        **{name: {manner: _flights(wires.flown[name, manner]) for manner in MANNERS} for name in (OLD, NEW)},
        "difference": None if wires.won is None else wires.won._asdict(),
        "ended": wires.ended,
        "log": wires.log,
    }


def _replanning(closed: Closed) -> dict[str, Any] | None:
    """Return the difference between `mppi` and the recommended policy, by place."""
    if REPLANNED not in closed.policies:
        return None
    best = OLD if advise(closed).fly == "old" else NEW
    return {key: closed.won(key, REPLANNED, best)._asdict() for key in (PATCHED, HELD_OUT)}


def _retrained(retrained: Retrained) -> dict[str, Any]:
    return {
        "policy": retrained.policy.name,
        "frames": retrained.frames,
        "seconds": round(retrained.seconds, 1),
        "validation_before": retrained.before,
        "validation_after": retrained.after,
        "better": retrained.better,
    }
