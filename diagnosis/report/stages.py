"""Stage by stage: a paragraph each in plain words, and the effects in a table."""

from collections.abc import Sequence

from softarm.diagnosis.engine.result import Diagnosis
from softarm.diagnosis.report.words import (
    UNSEEN,
    change,
    interval,
    lacking,
    less,
    meaning,
    of_stage,
    one_of,
    percents,
    reduction,
    sizes,
    stages_of,
    times,
)
from softarm.pages.markup import Html, el, join, prose, table
from softarm.pages.numbers import listed, number, percent, quantity
from softarm.schemas.verdict import Interval, NamedEffect, Quantity

_NOTHING_LEFT = 1.05  # floors
_EXPLAINED = 2  # effects whose meaning fits a paragraph; more have it in the table


def paragraphs(diagnosis: Diagnosis) -> dict[str, str]:
    """Stage -> what was found there, with its interval."""
    return {stage: _paragraph(diagnosis, stage) for stage in stages_of(diagnosis)}


def section(diagnosis: Diagnosis) -> Html:
    """The paragraphs, and beneath them the table of effects."""
    told = [
        el("p", el("b", "Tip, whole chain" if stage == "chain" else stage), ": ", prose(text))
        for stage, text in paragraphs(diagnosis).items()
    ]
    return join([*(told or [el("p", "No stage could be compared.", class_="none")]), effects(diagnosis)])


def _paragraph(diagnosis: Diagnosis, stage: str) -> str:
    named = of_stage(diagnosis, stage)
    before, after = (q.get(stage) for q in (diagnosis.verdict.gap.before, diagnosis.verdict.gap.after))
    floor = diagnosis.verdict.gap.floor.get(stage)
    if before is None:
        return f"{_lacks(diagnosis, named)}. Its gap could not be measured on this data."
    if named and after is None:
        return (
            f"{_lacks(diagnosis, named)}. Its gap is {quantity(before.value, before.unit)} RMS, held out not measured."
        )
    if named and len(named) <= _EXPLAINED:
        return f"{_lacks(diagnosis, named)}. {_with(diagnosis, stage, len(named))}{_rest(after, floor)}."
    if named:
        return f"{_with(diagnosis, stage, len(named))}{_rest(after, floor)}. {_lacks(diagnosis, named)}."
    if diagnosis.verdict.effects and (reduction(before, after) or 0.0) > 0.005:
        who = "the tip's gap" if stage == "chain" else "no effect of its own is named; its gap"
        shrunk = f"{change(before, after, ' to ')} RMS ({less(diagnosis, stage)})" if after else ""
        return f"{who} shrinks with the others' from {shrunk}{_rest(after, floor)}."
    return _nobody(diagnosis, stage, before, floor)


def _lacks(diagnosis: Diagnosis, named: Sequence[NamedEffect]) -> str:
    it = f"its {lacking(diagnosis)}"
    if len(named) > _EXPLAINED:
        return f"The {len(named)}: {'; '.join(_sized(each) for each in named)}"
    return "; ".join(f"{it} {_relation(diagnosis, each)} {_told(diagnosis, each)}" for each in named)


def _relation(diagnosis: Diagnosis, effect: NamedEffect) -> str:
    if diagnosis.nominal is None or diagnosis.patched is None or effect.name not in diagnosis.nominal.effects:
        return "lacks"
    return "has other values of" if effect.name in diagnosis.patched.effects else "has, and the robot has not,"


def _sized(effect: NamedEffect) -> str:
    """`servo1.lag, time 60 ms (55 to 65)`; of a set, whose size it is."""
    size = sizes(effect)
    if not effect.equivalents:
        return f"{effect.name}{', ' if size else ''}{size}"
    return f"{one_of(effect)}{f'; if it is the first, {size}' if size else ''}"


def _told(diagnosis: Diagnosis, effect: NamedEffect) -> str:
    """The same, with what each is."""
    if not effect.equivalents:
        says, size = meaning(diagnosis, effect.name), sizes(effect)
        return f"{effect.name}{f' ({says})' if says else ''}{f', {size}' if size else ''}"
    each = [f"{name} ({says})" for name in (effect.name, *effect.equivalents) if (says := meaning(diagnosis, name))]
    text = f"one of {listed(each, 'or')}, this recording cannot tell which" if each else one_of(effect)
    size = sizes(effect)
    return f"{text}{f'; if it is {effect.name}, {size}' if size else ''}"


def _with(diagnosis: Diagnosis, stage: str, effects: int) -> str:
    """How far the gap shrinks, and where that was seen."""
    gap = diagnosis.verdict.gap
    before, after = gap.before[stage], gap.after[stage]
    verb = "shrinks" if (reduction(before, after) or 0.0) >= 0 else "grows"
    told = f"its gap {verb} from {change(before, after, ' to ')} RMS ({less(diagnosis, stage)})"
    unseen = UNSEEN[diagnosis.held_out]
    if effects > _EXPLAINED:
        return f"{told}, {unseen}, with the {effects} effects that its {lacking(diagnosis)} lacks"
    return f"With {'both' if effects == 2 else 'it'}, {told}, {unseen}"


def _rest(after: Quantity | None, floor: Quantity | None) -> str:
    """What is left, in floors."""
    if after is None or floor is None or (ratio := times(after, floor)) is None:
        return ""
    if ratio < _NOTHING_LEFT:
        return f"; {quantity(floor.value, floor.unit)} count as none, so nothing is left"
    return f"; what is left is {number(ratio, 2)} times the {quantity(floor.value, floor.unit)} that count as none"


def _nobody(diagnosis: Diagnosis, stage: str, before: Quantity, floor: Quantity | None) -> str:
    """Of a stage for which no effect is named, and which those of others do not change."""
    size, ratio = f"{quantity(before.value, before.unit)} RMS", times(before, floor)
    if ratio is None or floor is None:
        return f"a gap of {size}; nobody says how much counts as none"
    none = f"{quantity(floor.value, floor.unit)}"
    if ratio <= 1:
        return f"no gap: {size}, where {none} count as none."
    could = reduction(before, diagnosis.verdict.gap.ceiling.get(stage))
    some = f"; some model could take away {percent(could)} of it" if could and could > 0.005 else ""
    told = f"{size}, {number(ratio, 2)} times the {none} that count as none"
    if diagnosis.verdict.verdict == "none":
        return f"{told}: too little to blame anything, and not proof that nothing is there{some}."
    return f"{told}; no effect is named for it{some}."


def effects(diagnosis: Diagnosis) -> Html:
    """The named effects: what each means, its size, what it adds."""
    named = diagnosis.verdict.effects
    if not named:
        return Html("")
    tip, sure = any(e.shrink.chain for e in named), any(e.confidence is not None for e in named)
    order = {stage: i for i, stage in enumerate(stages_of(diagnosis))}
    rows, last = [], ""
    for e in sorted(named, key=lambda e: order[e.name.rpartition(".")[0]]):
        stage = e.name.rpartition(".")[0]
        row: list[Html | str] = ["" if stage == last else stage, _names(e), _sizes(e), _meanings(diagnosis, e)]
        row.append(_share(e.shrink.stage))
        row += [_share(e.shrink.chain)] if tip else []
        row += ["–" if e.confidence is None else percent(e.confidence)] if sure else []
        rows.append(row)
        last = stage
    head = ["stage", "effect", "size (95 %)", "what it is", "takes of its stage's gap"]
    head += ["takes of the tip's"] * tip + ["confidence"] * sure
    caption = f"Effects by stage; what each takes beside the others, {UNSEEN[diagnosis.held_out]}, 95 %"
    return el("div", table(head, rows, caption), class_="effects")


def _share(of: Interval | None) -> Html:
    return el("span", "–" if of is None else percents(of), class_="size")


def _names(effect: NamedEffect) -> Html:
    first, *others = (name.rpartition(".")[2] for name in (effect.name, *effect.equivalents))
    return join([el("code", first), *(el("span", "or ", el("code", name), class_="or") for name in others)])


def _meanings(diagnosis: Diagnosis, effect: NamedEffect) -> Html:
    said = [meaning(diagnosis, name) or "–" for name in (effect.name, *effect.equivalents)]
    return join([prose(said[0]), *(el("span", "or ", prose(text), class_="or") for text in said[1:])])


def _sizes(effect: NamedEffect) -> Html:
    """A line a parameter; of a set, of its first."""
    of = [f"{name} {interval(each, each.unit)}" for name, each in effect.parameters.items()]
    return join([el("span", prose(text), class_="size") for text in of]) if of else Html("–")
