"""What summary.json of `softarm close-gap` holds."""

import math
from collections.abc import Mapping
from typing import Any

from softarm.flights.closing.closed import Closed
from softarm.flights.closing.outcomes import HELD_BACK, MANNERS, NEW, OLD, PATCHED, REPLANNED, REST, Flights, better
from softarm.flights.closing.wires import Wires
from softarm.flights.many import shares
from softarm.schemas.flights import CART_STARTS_M
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
        "held_back_robot": closed.place(HELD_BACK).title,
        "flights": closed.flights,
        "success": {place.key: _success(closed, place.key) for place in closed.places},
        "fly": closed.advice.fly,
        "against_retrained": list(closed.advice.against),
        "mppi_beyond_advised": _replanning(closed),
        "wires": None if closed.wires is None else _wires(closed.wires),
        "retrained": None if closed.retrained is None else _retrained(closed.retrained),
        "spent": spent,
    }


def _success(closed: Closed, place: str) -> dict[str, Any]:
    """By policy, from rest by height too; how the two differ."""
    told: dict[str, Any] = {}
    for name in closed.policies:
        if (name, place, REST) not in closed.flown:
            continue
        told[name] = {manner: _flights(closed.flown[name, place, manner]) for manner in MANNERS}
        reached = closed.flown[name, place, REST].reached.reshape(-1, len(CART_STARTS_M))
        parts = shares(reached, closed.targets)._asdict()
        told[name] |= {part: None if math.isnan(share) else share for part, share in parts.items()}
    if NEW in told:
        for manner in MANNERS:
            old, new = closed.flown[OLD, place, manner], closed.flown[NEW, place, manner]
            told[manner] = {**closed.changed(place, manner), "difference": better(old, new)._asdict()}
        told["difference"] = closed.won(place)._asdict()
        told["stops_difference"] = closed.stops_more(place)._asdict()
    return told


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
    """`mppi` beside the policy that is advised, by place."""
    if REPLANNED not in closed.policies:
        return None
    best = OLD if closed.advice.fly == "old" else NEW
    return {key: closed.won(key, REPLANNED, best)._asdict() for key in (PATCHED, HELD_BACK)}


def _retrained(retrained: Retrained) -> dict[str, Any]:
    return {
        "policy": retrained.policy.name,
        "frames": retrained.frames,
        "seconds": round(retrained.seconds, 1),
        "validation_before": retrained.before,
        "validation_after": retrained.after,
        "better": retrained.better,
    }
