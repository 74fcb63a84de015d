"""A diagnosis in plain words: the answer in three sentences, changes and intervals as people read them."""

import math
from collections.abc import Mapping, Sequence

from softarm.diagnosis.engine.result import Diagnosis
from softarm.pages.numbers import listed, number, percent, quantity, scaled
from softarm.schemas.verdict import Interval, NamedEffect, Quantity
from softarm.simulator import effects

_HEADLINE_MOST = 3  # names


def change(before: Quantity, after: Quantity, arrow: str = " → ") -> str:
    """Two root mean squares of one unit: `0.98 → 0.034 kPa`."""
    shown, factor = scaled(before.unit, max(before.value, after.value))
    return f"{number(before.value * factor, 2)}{arrow}{number(after.value * factor, 2)} {shown}".strip()


def interval(of: Interval, unit: str = "") -> str:
    """An estimate with its bounds: `61 ms (55 to 68)`; as many digits as the bounds' distance deserves."""
    all_three = (of.value, of.low, of.high)
    finite = [abs(v) for v in all_three if math.isfinite(v)]
    shown, factor = scaled(unit, max(finite, default=0.0))
    half = (of.high - of.low) / 2 * factor
    if 1e-4 <= half < math.inf:
        decimals = max(0, -math.floor(math.log10(half / 3)))  # a half width of 3 to 29 units of the last digit
        value, low, high = (f"{v * factor:.{decimals}f}" for v in all_three)
    else:
        value, low, high = (number(v * factor) for v in all_three)
    return f"{value} {shown}".strip() + f" ({low} to {high})"


def percents(of: Interval) -> str:
    """An interval of a share: `74 % (70 to 78)`."""
    return f"{percent(of.value)} ({round(100 * of.low)} to {round(100 * of.high)})"


def meaning(name: str) -> str:
    """What the registry says of an effect; empty for one of another rig."""
    return effects.REGISTRY[name].meaning if name in effects.REGISTRY else ""


def unit_of(path: str, rigs: Mapping[str, str]) -> str:
    """Unit of `stage.effect.parameter`, of another rig by its own; empty for what neither knows."""
    if path in rigs:
        return rigs[path]
    try:
        return effects.find(path)[1].unit
    except effects.EffectError:
        return ""


def reduction(before: Quantity | None, after: Quantity | None) -> float | None:
    """The share of a root mean square that went; None where one of the two is not known."""
    if before is None or after is None or before.value <= 0:
        return None
    return 1 - after.value / before.value


def answer(diagnosis: Diagnosis) -> tuple[str, str, str]:
    """What, how sure, how far the gap shrinks: a sentence each."""
    kind = diagnosis.verdict.verdict
    if kind == "none":
        return _none(diagnosis)
    if kind == "unknown" or not diagnosis.verdict.effects:
        return _unknown(diagnosis)
    return _what(diagnosis), _how_sure(diagnosis), _shrinks(diagnosis)


def _relation(diagnosis: Diagnosis, effect: NamedEffect) -> str:
    """How simulator and robot differ in an effect."""
    if diagnosis.nominal is None or diagnosis.patched is None or effect.name not in diagnosis.nominal.effects:
        return "The simulator lacks {}"
    if effect.name not in diagnosis.patched.effects:
        return "The simulator has {}, and the robot does not"
    return "The simulator has {} with other values than the robot"


def _one(effect: NamedEffect, parameters: bool) -> str:
    """An effect, or the set that it cannot be told from."""
    if effect.equivalents:
        return f"one of {listed((effect.name, *effect.equivalents), 'or')} (this data cannot tell which)"
    values = ", ".join(f"{name} {quantity(of.value, of.unit)}" for name, of in effect.parameters.items())
    return f"{effect.name} ({values})" if parameters and values else effect.name


def _what(diagnosis: Diagnosis) -> str:
    named = diagnosis.verdict.effects
    more = "; more of the gap could be explained" if diagnosis.verdict.verdict == "incomplete" else ""
    if len(named) == 1:
        says = "" if named[0].equivalents else meaning(named[0].name)
        values = "" if named[0].equivalents else _values(named[0])
        text = _relation(diagnosis, named[0]).format(_one(named[0], parameters=False))
        tail = "; ".join(part for part in (says, values) if part)
        return f"{text}{': ' if tail else ''}{tail}{more}."
    groups: dict[str, list[str]] = {}
    for effect in named:
        groups.setdefault(_relation(diagnosis, effect), []).append(_one(effect, parameters=True))
    parts = [relation.format(listed(names)) for relation, names in groups.items()]
    return "; ".join([parts[0], *(part[0].lower() + part[1:] for part in parts[1:])]) + more + "."


def _values(effect: NamedEffect) -> str:
    return ", ".join(f"{name} {interval(of, of.unit)}" for name, of in effect.parameters.items())


def _how_sure(diagnosis: Diagnosis) -> str:
    verdict = diagnosis.verdict
    sure = [percent(effect.confidence) for effect in sorted(verdict.effects, key=lambda e: e.confidence)]
    several = len(set(sure)) > 1
    shares = f"{sure[0]} to {sure[-1]}" if several else sure[0]
    if diagnosis.nominal is None:  # a table: no cases of known cause stand behind it
        answers = "these answers" if several else "this answer"
        text = f"Its own data, blocks drawn anew, give {answers} in {shares} of the draws"
    else:
        text = f"Of answers like {'these' if several else 'this one'}, {shares} were right where the cause was known"
    stage = verdict.where.stage
    if stage is None:
        return text + "."
    share = verdict.where.share.get(stage)
    of = "the gap" if share is None else f"{percent(share)} of the gap"
    of += f" arises in the {stage} stage"
    return f"{text}; {of}{f' ({verdict.where.regime})' if verdict.where.regime else ''}."


def _shrinks(diagnosis: Diagnosis) -> str:
    gap, stage = diagnosis.verdict.gap, diagnosis.verdict.where.stage or ""
    one, *more = diagnosis.verdict.effects
    it = "all of them" if more else one.name if one.equivalents else "it"
    parts = [_shrink_of(diagnosis, stage, f"the {stage} stage's gap", first=True)]
    if stage != "chain":
        parts.append(_shrink_of(diagnosis, "chain", "the tip's over the whole chain", first=False))
    parts = [part for part in parts if part]
    if not parts:
        return "How far the gap shrinks could not be measured on this data."
    floor = gap.floor.get(stage)
    last = f"; no simulator is blamed for the last {quantity(floor.value, floor.unit)}" if floor else ""
    return f"With {it} corrected in the simulator, {' and '.join(parts)}, on data that no fit has seen{last}."


def _shrink_of(diagnosis: Diagnosis, place: str, whose: str, first: bool) -> str:
    gap = diagnosis.verdict.gap
    before, after = gap.before.get(place), gap.after.get(place)
    share = reduction(before, after)
    if before is None or after is None or share is None:
        return ""
    bounds = shrink_bounds(diagnosis) if first else ""
    verb = "shrinks" if share >= 0 else "grows"
    return (
        f"{whose} {verb} from {change(before, after, ' to ')} RMS "
        f"({percent(abs(share))} {'less' if share >= 0 else 'more'}{bounds})"
    )


def shrink_bounds(diagnosis: Diagnosis) -> str:
    """The 95 % interval of the stage's shrink, as `, 70 to 78 %`; it is one effect's, so none where there are more."""
    if len(diagnosis.verdict.effects) != 1:
        return ""
    of = diagnosis.verdict.effects[0].shrink.stage
    return f", {round(100 * of.low)} to {round(100 * of.high)} %"


def _unknown(diagnosis: Diagnosis) -> tuple[str, str, str]:
    verdict, stage = diagnosis.verdict, diagnosis.verdict.where.stage
    before, ceiling = verdict.gap.before.get(stage or ""), verdict.gap.ceiling.get(stage or "")
    could = reduction(before, ceiling)
    where = f"in the {stage} stage" if stage else "between robot and simulator"
    regime = f" ({verdict.where.regime})" if verdict.where.regime else ""
    what = f"There is a gap {where}{regime} that can be explained, and none of the known effects explains it."
    mine = [r for r in diagnosis.rivals if stage and any(name.startswith(f"{stage}.") for name in r.names)]
    best = max(mine or diagnosis.rivals, key=lambda r: r.alone, default=None)
    any_model = "some model could shrink it" if could is None else f"some model could take away {percent(could)} of it"
    if best is None:
        sure = f"On data that no fit has seen, {any_model}."
    else:
        sure = (
            f"On data that no fit has seen, {any_model}, while the known effect that comes closest, "
            f"{' with '.join(best.names)}, takes away {percent(max(0.0, best.alone))}."
        )
    feature = next((name for left in diagnosis.leftovers if left.stage == stage for name, _ in left.depends_on), None)
    hint = f"; what is left depends most on {feature}" if feature else ""
    return what, sure, f"So nothing is changed in the simulator, and the gap stays as it is{hint}."


def _none(diagnosis: Diagnosis) -> tuple[str, str, str]:
    gap = diagnosis.verdict.gap
    near = {stage: q.value / gap.floor[stage].value for stage, q in gap.before.items() if _has(gap.floor, stage)}
    sure = "No stage exceeds its floor."
    if near:
        stage = max(near, key=lambda name: near[name])
        left, floor = gap.before[stage], gap.floor[stage]
        sure = (
            f"Nearest to its floor is {'the whole chain' if stage == 'chain' else f'the {stage} stage'}: "
            f"{quantity(left.value, left.unit)} RMS, where {quantity(floor.value, floor.unit)} count as none."
        )
    return (
        "There is no gap beyond repeatability and noise: simulator and robot agree on this data.",
        sure,
        "Nothing needs to change in the simulator; other excitations may still show a gap.",
    )


def _has(floor: Mapping[str, Quantity], stage: str) -> bool:
    return stage in floor and floor[stage].value > 0


def headline(diagnosis: Diagnosis) -> str:
    """The answer in a few words."""
    verdict = diagnosis.verdict
    if verdict.verdict == "none":
        return "No gap"
    if verdict.verdict == "unknown" or not verdict.effects:
        return f"An unknown effect in {verdict.where.stage}" if verdict.where.stage else "An unknown effect"
    names = [_few((e.name, *e.equivalents), "or") for e in verdict.effects]
    return _few(names, "and") + (", and more" if verdict.verdict == "incomplete" else "")


def _few(names: Sequence[str], last: str) -> str:
    """A list that stays a headline; the rest is counted."""
    more = len(names) - _HEADLINE_MOST
    return listed(names, last) if more < 2 else listed((*names[:_HEADLINE_MOST], f"{more} others"), last)
