"""Content of summary.json, written by `softarm close-gap`."""

from typing import Any

from softarm.evaluation.closing.advice import advise
from softarm.evaluation.closing.closed import Closed
from softarm.evaluation.closing.outcomes import MANNERS, NEW, OLD, Flights
from softarm.evaluation.closing.wires import Wires
from softarm.simulator.model_rows import differences
from softarm.training.run.retrain import Retrained


def summary(closed: Closed) -> dict[str, Any]:
    """Return the results as plain values."""
    diagnosis, advice = closed.diagnosis, advise(closed)
    patch = differences(diagnosis.nominal, diagnosis.patched) if diagnosis.nominal and diagnosis.patched else []
    return {
        "verdict": diagnosis.verdict.verdict,
        "effects": [effect.name for effect in diagnosis.verdict.effects],
        "patch": [row._asdict() for row in patch],
        "limits": closed.rail.summary(),
        "policy": str(closed.policy),
        "judged_on": closed.judged.title,
        "old": {place: _flights(flown) for (name, place), flown in closed.flown.items() if name == OLD},
        "ways": {name: _way(closed, name) for name in (OLD, *closed.ways)},
        "fly": advice.fly,
        "against": {name: list(reasons) for name, reasons in advice.against.items()},
        "wires": None if closed.wires is None else _wires(closed.wires),
        "retrained": None if closed.retrained is None else _retrained(closed.retrained),
        "spent": closed.spent,
    }


def _way(closed: Closed, name: str) -> dict[str, Any]:
    """Return a policy's success on the judging robot, and its difference to the old one over the same draws."""
    wall_s, cpu_s = closed.seconds(name)
    own = {
        **{manner: _flights(closed.of(name, manner)) for manner in MANNERS},
        "wall_s": round(wall_s, 1),
        "cpu_s": round(cpu_s, 1),
    }
    if name == OLD:
        return own
    return own | {"difference": closed.won(name)._asdict(), "stops_difference": closed.stops_more(name)._asdict()}


def _flights(flown: Flights) -> dict[str, Any]:
    stops = [stop for stop in flown.stops if stop is not None]
    low, high = flown.interval
    return {
        "flights": int(flown.reached.size),
        "reached": int(flown.reached.sum()),
        "low": round(low, 3),
        "high": round(high, 3),
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


def _retrained(retrained: Retrained) -> dict[str, Any]:
    return {
        "policy": retrained.policy.name,
        "frames": retrained.frames,
        "seconds": round(retrained.seconds, 1),
        "validation_before": retrained.before,
        "validation_after": retrained.after,
        "better": retrained.better,
    }
