"""Rivals of the named effects, as the report lists them."""

from collections.abc import Iterator, Mapping

import numpy as np

from softarm.diagnosis.answer.assembly import share
from softarm.diagnosis.engine import shrink
from softarm.diagnosis.engine.decision import Decision
from softarm.diagnosis.engine.examination import Examination
from softarm.diagnosis.engine.fits import Fit
from softarm.diagnosis.engine.result import Rival
from softarm.diagnosis.engine.search import Choice, Gain, Search
from softarm.schemas.verdict import Interval

FURTHER_SHOWN = 6
AT_BOUND = "at its bound"
NOT_RESOLVED = "not resolved"


def not_named(choice: Choice, decision: Decision) -> Iterator[str]:
    """Yield a warning for each fitted effect that is not named."""
    for effect in choice.selected:
        if effect in decision.unresolved:
            yield f"{effect.candidate.name} is not named: next to the named effects, the recordings do not resolve it"
        elif effect not in decision.selected:
            yield (
                f"{effect.candidate.name} is not named: it shrinks the fitted gap, but leaves too much, is not steady "
                "or does not predict held-out data"
            )


def not_rated(decision: Decision) -> Iterator[str]:
    """Yield a warning for each named effect without a confidence that its size or a rival's bound explains."""
    for effect in decision.selected:
        if effect.bounded:
            yield (
                f"{effect.candidate.name} is not rated: {', '.join(effect.bounded)} explains as much at the end of its "
                "range, and that bound may be the only reason against it"
            )
        elif effect.tolerated:
            yield (
                f"{effect.candidate.name} is not rated: its size is within the tolerance of a healthy system, and "
                "blind tests had too few such answers"
            )


def by_gain(search: Search, choice: Choice, decision: Decision) -> tuple[Rival, ...]:
    """Return the named effects and the best other candidates, with gains relative to the named effects' losses."""
    selected = decision.selected
    alone = {fit.names[0]: _largest_share(gain) for fit, gain in choice.alone}
    found = []
    for effect in (*selected, *decision.unresolved):
        name = effect.candidate.name
        same = f"; not separable from {', '.join(effect.equivalents)}" if effect.equivalents else ""
        own_gain = _relative(effect.gain, max(effect.gain.value, 1e-9))
        note = f"named{same}" if effect in selected else NOT_RESOLVED
        found.append(Rival(name, alone.get(name, 0.0), own_gain, _own(choice.chosen.point, name), note))
    further = search.ranked(choice.chosen)[:FURTHER_SHOWN]
    scale = max((m.gain.value for m in selected), default=max((g.value for _, g in further), default=1.0)) or 1.0
    for fit, gain in further:
        name = fit.effects[-1].name
        note = AT_BOUND if fit.at_bound else "adds too little to be named"
        found.append(Rival(name, alone.get(name, 0.0), _relative(gain, scale), _own(fit.point, name), note))
    return tuple(found)


def by_share(found: Examination, decision: Decision) -> tuple[Rival, ...]:
    """Return every candidate with the shares of the RMS that it removes alone and next to the others."""
    search, chosen, null_model = found.search, found.searched, found.choice.null_model
    alone = {f.effects[0].name: f for f in search.extended(null_model)}
    further = {f.effects[-1].name: f for f in search.extended(chosen)}
    causes = {effect.candidate.name: effect for effect in (*decision.selected, *decision.unresolved)}
    rivals = []
    for name, fit in alone.items():
        lone = min(max(_removed(null_model, fit).value, 0.0), 1.0)
        more, less, note = further.get(name, fit), chosen if name in further else null_model, ""
        if name in causes:
            more, less = chosen, causes[name].without
            note = "named" if causes[name] in decision.selected else NOT_RESOLVED
        elif same := [each.candidate.name for each in decision.selected if name in each.equivalents]:
            note = f"not separable from {same[0]}"
        elif more.at_bound:
            note = AT_BOUND
        rivals.append(Rival(name, lone, _removed(less, more), _own(more.point, name), note))
    return tuple(sorted(rivals, key=lambda r: (-r.alone, r.name)))


def _largest_share(gain: Gain) -> float:
    """Return the largest share of a stage's RMS that a gain removes."""
    return max((1 - float(np.sqrt(max(1 - s, 0.0))) for s in gain.shares.values()), default=0.0)


def _relative(gain: Gain, scale: float) -> Interval:
    return Interval(value=gain.value / scale, low=gain.low / scale, high=gain.high / scale)


def _own(point: Mapping[str, float], name: str) -> dict[str, float]:
    return {path: x for path, x in point.items() if path.startswith(f"{name}.") and np.isfinite(x)}


def _removed(less: Fit, more: Fit) -> Interval:
    """Return the share of the RMS that `more` removes from `less`, with a bootstrap over blocks."""
    return share(*shrink.drawn(np.maximum(less.held_out, 0.0), np.maximum(more.held_out, 0.0)))
