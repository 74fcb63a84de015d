"""Confidence of an answer, from the share of correct answers among blind cases with known causes.

`confidence.json` holds the counts for the robot and for rigs, for a single name and for a set, by margin; it is written
by `validation.confidence`. An answer with fewer than `CASES_LEAST` cases has no confidence.
"""

import json
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.resources import files
from typing import Any, Literal

from softarm.diagnosis.engine.search import SelectedEffect

CASES_LEAST = 5
System = Literal["robot", "rig"]


def confidence(system: System, effect: SelectedEffect) -> float | None:
    """Return the confidence of a named effect.

    It is None for too few cases, for an effect that another set of effects replaces, for one within the tolerance of
    a healthy system, and for one whose rival fits as well at the end of its range: the bound may be the only reason
    against the rival.
    """
    if not _is_rated(effect):
        return None
    return frequency(_table()[system], "set" if effect.equivalents else "alone", margin(effect))


def margin(effect: SelectedEffect) -> float:
    """Return the lead over the best rival outside the set, as a share of the effect's gain; 0 is a tie."""
    lacks = [g.value for f, g in effect.rivals if f.effects[-1].name not in effect.equivalents]
    return max(min([1.0, *(lack / max(effect.gain.value, 1e-9) for lack in lacks)]), 0.0)


def margins(selected: Iterable[SelectedEffect]) -> dict[str, float]:
    """Return the margins, by name, of the effects that may have a confidence."""
    return {effect.candidate.name: margin(effect) for effect in selected if _is_rated(effect)}


def _is_rated(effect: SelectedEffect) -> bool:
    return not (effect.bounded or effect.exchangeable or effect.tolerated)


def frequency(curves: dict[str, Any], answer: Literal["alone", "set"], margin: float) -> float | None:
    """Return the chance of a correct answer at the highest margin reached, or None for too few cases."""
    reached = [each for each in curves[answer] if each["margin"] <= margin and each["of"] >= CASES_LEAST]
    if not reached:
        return None
    return chance(max(reached, key=lambda each: float(each["margin"])))


def chance(counts: Mapping[str, float]) -> float:
    """Return the chance of a correct answer after `right` of `of` cases, by Laplace's rule of succession.

    No number of cases makes an answer certain.
    """
    return (counts["right"] + 1) / (counts["of"] + 2)


@cache
def _table() -> dict[str, Any]:
    text = (files("softarm.diagnosis.engine") / "confidence.json").read_text()
    return dict(json.loads(text))
