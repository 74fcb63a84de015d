"""How often an answer like this one was right, on cases of known cause that no published benchmark holds; else None.

`confidence.json` holds the cases: by customer (the robot, rigs) and kind of answer (a name alone, a set) the share of
right ones from each margin to the next, and the commands that made them (`softarm.diagnosis.blind.curve` writes it).
What fewer than `CASES_LEAST` cases stand behind has no
confidence: a number that was not measured is none.
"""

import json
from collections.abc import Iterable
from functools import cache
from importlib.resources import files
from typing import Any, Literal

from softarm.diagnosis.engine.search import SelectedEffect

CASES_LEAST = 10
Customer = Literal["robot", "rig"]


def confidence(customer: Customer, effect: SelectedEffect) -> float | None:
    """Of a named effect. One whose rival stands at the end of its range has none: that end may be what rules it out."""
    if effect.bounded:
        return None
    return frequency(_table()[customer], "set" if effect.equivalents else "alone", margin(effect))


def margin(effect: SelectedEffect) -> float:
    """What the best rival that is no equivalent lacks, as a share of what the effect gains: 0 is a tie."""
    lacks = [g.value for f, g in effect.rivals if f.effects[-1].name not in effect.equivalents]
    return max(min([1.0, *(lack / max(effect.gain.value, 1e-9) for lack in lacks)]), 0.0)


def margins(selected: Iterable[SelectedEffect]) -> dict[str, float]:
    """Of those that may have a confidence, by name."""
    return {effect.candidate.name: margin(effect) for effect in selected if not effect.bounded}


def frequency(curves: dict[str, Any], answer: Literal["alone", "set"], margin: float) -> float | None:
    """Share of right answers of a kind among the cases of the highest margin that is reached; None: too few cases."""
    reached = [each for each in curves[answer] if each["margin"] <= margin and each["of"] >= CASES_LEAST]
    if not reached:
        return None
    best = max(reached, key=lambda each: float(each["margin"]))
    return float(best["right"] / best["of"])


@cache
def _table() -> dict[str, Any]:
    text = (files("softarm.diagnosis.engine") / "confidence.json").read_text()
    return dict(json.loads(text))
