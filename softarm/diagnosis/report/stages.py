"""Results stage by stage: one paragraph each, and a table of the effects."""

from collections.abc import Sequence

from softarm.diagnosis.engine.result import Diagnosis
from softarm.diagnosis.report.answer import NOT_RATED
from softarm.diagnosis.report.words import (
    HELD_OUT,
    change,
    described,
    entries,
    interval,
    meaning,
    noise_level,
    of_stage,
    one_of,
    percents,
    reduction,
    relation,
    shrinks,
    shrinks_by,
    sizes,
    stages_of,
)
from softarm.reporting.markup import Html, el, join, prose, table
from softarm.reporting.numbers import listed, number, percent, quantity
from softarm.schemas.verdict import Interval, NamedEffect, Quantity

_AT_FLOOR = 1.05  # noise floors
_EXPLAINED_MAX = 2  # effects whose meaning fits a paragraph; more have it in the table


def paragraphs(diagnosis: Diagnosis) -> dict[str, str]:
    """Return the findings of each stage as one paragraph of text, by stage."""
    return {stage: _paragraph(diagnosis, stage) for stage in stages_of(diagnosis)}


def section(diagnosis: Diagnosis) -> Html:
    """Return the paragraphs and the table of effects."""
    shown = [
        el("p", el("b", "Tip, whole chain" if stage == "chain" else stage), ": ", prose(text))
        for stage, text in paragraphs(diagnosis).items()
    ]
    return join([*(shown or [el("p", "No stage could be compared.", class_="none")]), effects(diagnosis)])


def _paragraph(diagnosis: Diagnosis, stage: str) -> str:
    named = of_stage(diagnosis, stage)
    gap = diagnosis.verdict.gap
    if stage not in gap.before:
        return f"{_causes(diagnosis, named)}. The gap could not be measured on this data."
    before, after, floor = gap.before[stage], gap.after[stage], gap.floor[stage]
    if named and len(named) <= _EXPLAINED_MAX:
        return f"{_causes(diagnosis, named)}. {_shrinks(diagnosis, stage, len(named))}{_rest(after, floor)}."
    if named:
        return f"{_shrinks(diagnosis, stage, len(named))}{_rest(after, floor)}. {_causes(diagnosis, named)}."
    if diagnosis.verdict.effects and (reduction(before, after) or 0.0) > 0.005:
        shrunk = f"{change(before, after, ' to ')} RMS ({shrinks_by(diagnosis, stage)})"
        own = "" if stage == "chain" else "no effect of this stage is named. "
        return f"{own}With the named effects, the gap shrinks from {shrunk}{_rest(after, floor)}."
    return _without_effect(diagnosis, stage, before, floor)


def _causes(diagnosis: Diagnosis, named: Sequence[NamedEffect]) -> str:
    if len(named) > _EXPLAINED_MAX:
        return f"The {len(named)} effects: {'; '.join(_sized(each) for each in named)}"
    return "; ".join(f"{relation(diagnosis, each)}: {_described(diagnosis, each)}" for each in named)


def _sized(effect: NamedEffect) -> str:
    """Return `servo1.lag, time 60 ms (55 to 65)`; for a set, state whose size it is."""
    size = sizes(effect)
    if not effect.equivalents:
        return f"{effect.name}{', ' if size else ''}{size}"
    return f"{one_of(effect)}{f'; for the first, {size}' if size else ''}"


def _described(diagnosis: Diagnosis, effect: NamedEffect) -> str:
    """Return an effect with its size; of stages that share it, the first states the sizes that all of them have."""
    size, (first, *_) = sizes(effect), entries(diagnosis, effect)
    if not effect.equivalents:
        if first is effect or effect.parameters.keys() - first.parameters.keys():
            return described(diagnosis, effect)
        stage, _, law = first.name.rpartition(".")
        return f"the {law} stated for {stage}"
    members = [f"{n} ({text})" for n in (effect.name, *effect.equivalents) if (text := meaning(diagnosis, n))]
    text = f"either {listed(members, 'or')}; this data cannot separate them" if members else one_of(effect)
    return f"{text}{f'. For {effect.name}, {size}' if size else ''}"


def _shrinks(diagnosis: Diagnosis, stage: str, effects: int) -> str:
    """Return how far the gap shrinks, and on which held-out data."""
    with_them = f"all {effects} effects" if effects > _EXPLAINED_MAX else "both" if effects == 2 else "it"
    return f"With {with_them} corrected, the gap {shrinks(diagnosis, stage)} {HELD_OUT[diagnosis.held_out]}"


def _rest(after: Quantity, floor: Quantity) -> str:
    """Return the remaining gap in multiples of the noise floor."""
    ratio = after.value / floor.value
    if ratio < _AT_FLOOR:
        return f". The rest is noise: {noise_level(floor)}"
    return f". The rest is {number(ratio, 2)} times the noise floor of {quantity(floor.value, floor.unit)}"


def _without_effect(diagnosis: Diagnosis, stage: str, before: Quantity, floor: Quantity) -> str:
    size, ratio = f"{quantity(before.value, before.unit)} RMS", before.value / floor.value
    if ratio <= 1:
        return f"no gap: {size}; {noise_level(floor)}."
    could = reduction(before, diagnosis.verdict.gap.ceiling.get(stage))
    some = f" A flexible model could remove {percent(could)} of it." if could and could > 0.005 else ""
    shown = f"{size}, {number(ratio, 2)} times the noise floor of {quantity(floor.value, floor.unit)}"
    if diagnosis.verdict.verdict == "none":
        return f"{shown}. That is too little to attribute to an effect, and no proof that the gap is zero.{some}"
    return f"{shown}. No effect is named for it.{some}"


def effects(diagnosis: Diagnosis) -> Html:
    """Return the table of named effects: meaning, size, and the share of the gap that each explains."""
    named = diagnosis.verdict.effects
    if not named:
        return Html("")
    tip = any(e.shrink.chain for e in named)
    order = {stage: i for i, stage in enumerate(stages_of(diagnosis))}
    rows, last = [], ""
    for e in sorted(named, key=lambda e: order[e.name.rpartition(".")[0]]):
        stage = e.name.rpartition(".")[0]
        members = (e.name, *e.equivalents)
        codes = _alternatives([el("code", name.rpartition(".")[2]) for name in members])
        meanings = _alternatives([prose(meaning(diagnosis, name) or "–") for name in members])
        row = ["" if stage == last else stage, codes, _sizes(e), meanings, _share(e.shrink.stage)]
        row += [_share(e.shrink.chain)] if tip else []
        row.append(NOT_RATED if e.confidence is None else percent(e.confidence))
        rows.append(row)
        last = stage
    head = ["stage", "effect", "size (95 % interval)", "meaning", "unique share, stage"]
    head += ["unique share, tip"] * tip + ["confidence"]
    caption = f"Effects by stage; shares {HELD_OUT[diagnosis.held_out]}, with 95 % intervals"
    return el("div", table(head, rows, caption), _definitions(tip), class_="effects")


def _definitions(tip: bool) -> Html:
    text = (
        "Unique share: how much of the gap (RMS) disappears when this effect joins all the other named effects. "
        "Shares of effects that overlap do not add up to 100 %."
    )
    text += " Stage: the stage alone, driven by measured inputs." if tip else ""
    text += " Tip: the tip's position, simulated from commands alone through every stage." if tip else ""
    return el("p", text, class_="hint")


def _share(of: Interval | None) -> Html:
    return el("span", "–" if of is None else percents(of), class_="size")


def _alternatives(members: Sequence[Html]) -> Html:
    return join([members[0], *(el("span", "or ", each, class_="or") for each in members[1:])])


def _sizes(effect: NamedEffect) -> Html:
    """Return one line per parameter; a set shows the parameters of its first effect."""
    of = [f"{name} {interval(each, each.unit)}" for name, each in effect.parameters.items()]
    return join([el("span", prose(text), class_="size") for text in of]) if of else Html("–")
