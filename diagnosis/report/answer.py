"""The answer in three sentences, and in a headline."""

from collections.abc import Sequence

from softarm.diagnosis.engine.result import Diagnosis
from softarm.diagnosis.report.words import (
    UNSEEN,
    change,
    lacking,
    less,
    meaning,
    one_of,
    reduction,
    sizes,
    stages_of,
    times,
)
from softarm.pages.numbers import listed, number, percent, quantity
from softarm.schemas.verdict import NamedEffect

_AS_GOOD = 0.9  # of what some model could take away: then a known effect does not fail for want of size
_NAMED_EACH = 4  # effects: more are counted, and told stage by stage


def answer(diagnosis: Diagnosis) -> tuple[str, str, str]:
    """What, how sure, how far the gap shrinks: a sentence each."""
    kind = diagnosis.verdict.verdict
    if kind == "none":
        return _none(diagnosis)
    if kind == "unknown" or not diagnosis.verdict.effects:
        return _unknown(diagnosis)
    return _what(diagnosis), _how_sure(diagnosis), _shrinks(diagnosis)


def headline(diagnosis: Diagnosis) -> str:
    """The answer in a few words."""
    verdict = diagnosis.verdict
    if verdict.verdict == "none":
        return "No gap" if not _above(diagnosis) else "No cause found"
    if verdict.verdict == "unknown" or not verdict.effects:
        return f"An unknown effect in {verdict.where.stage}" if verdict.where.stage else "An unknown effect"
    more = ", and more" if verdict.verdict == "incomplete" else ""
    if sum(1 + len(effect.equivalents) for effect in verdict.effects) > _NAMED_EACH:
        return f"{_counted(verdict.effects)}{more}"
    several = len(verdict.effects) > 1
    sets = [listed((e.name, *e.equivalents), "or") for e in verdict.effects]
    return listed([f"one of {s}" if several and " or " in s else s for s in sets]) + more


def _counted(effects: Sequence[NamedEffect]) -> str:
    """`3 effects in servo1`, `26 effects in 6 stages`, `one of 5 effects in servo1`."""
    stages = sorted({effect.name.rpartition(".")[0] for effect in effects})
    where = stages[0] if len(stages) == 1 else f"{len(stages)} stages"
    if len(effects) == 1:
        return f"One of {1 + len(effects[0].equivalents)} effects in {where}"
    sets = ", each of them one of a set" if all(effect.equivalents for effect in effects) else ""
    return f"{len(effects)} effects in {where}{sets}"


def _relation(diagnosis: Diagnosis, effect: NamedEffect) -> str:
    """How simulator and robot differ in an effect."""
    it = lacking(diagnosis)
    if diagnosis.nominal is None or diagnosis.patched is None or effect.name not in diagnosis.nominal.effects:
        return f"The {it} lacks {{}}"
    if effect.name not in diagnosis.patched.effects:
        return f"The {it} has {{}}, and the robot does not"
    return f"The {it} has {{}} with other values than the robot"


def _what(diagnosis: Diagnosis) -> str:
    named = diagnosis.verdict.effects
    more = "; more of the gap could be explained" if diagnosis.verdict.verdict == "incomplete" else ""
    if len(named) == 1:
        says = "" if named[0].equivalents else meaning(diagnosis, named[0].name)
        values = "" if named[0].equivalents else sizes(named[0])
        text = _relation(diagnosis, named[0]).format(one_of(named[0]))
        tail = "; ".join(part for part in (says, values) if part)
        return f"{text}{': ' if tail else ''}{tail}{more}."
    if len(named) > _NAMED_EACH:
        return f"The {lacking(diagnosis)} lacks {_counted(named)}: {_by_law(named)}{more}."
    groups: dict[str, list[str]] = {}
    for effect in named:
        groups.setdefault(_relation(diagnosis, effect), []).append(_brief(effect))
    parts = [relation.format(listed(names)) for relation, names in groups.items()]
    return "; ".join([parts[0], *(part[0].lower() + part[1:] for part in parts[1:])]) + more + "."


def _brief(effect: NamedEffect) -> str:
    """An effect with its values, or the set that it cannot be told from."""
    values = ", ".join(f"{name} {quantity(of.value, of.unit)}" for name, of in effect.parameters.items())
    return f"{effect.name} ({values})" if values and not effect.equivalents else one_of(effect)


def _by_law(effects: Sequence[NamedEffect]) -> str:
    """`lag (servo1, servo2 and servo3), deadband or backlash (servo1)`: the laws, with the stages that have them."""
    found: dict[str, list[str]] = {}
    for effect in effects:
        laws = sorted(name.rpartition(".")[2] for name in (effect.name, *effect.equivalents))
        found.setdefault(listed(laws, "or"), []).append(effect.name.rpartition(".")[0])
    common = sorted(found.items(), key=lambda item: (-len(item[1]), item[0]))
    return ", ".join(f"{law} ({listed(sorted(stages))})" for law, stages in common)


def measured_confidence(diagnosis: Diagnosis) -> bool:
    """Whether the confidences are frequencies of cases of known cause; a table's own spread is told by a warning."""
    return diagnosis.nominal is not None or not any(
        "confidences of a table" in text for text in diagnosis.verdict.warnings
    )


def _how_sure(diagnosis: Diagnosis) -> str:
    verdict = diagnosis.verdict
    sure = [percent(c) for c in sorted(e.confidence for e in verdict.effects if e.confidence is not None)]
    shares = f"{sure[0]} to {sure[-1]}" if len(set(sure)) > 1 else "".join(sure[:1])
    several = len(set(sure)) > 1
    if not sure:
        text = "How often such an answer is right has not been measured, so no confidence is given"
    elif measured_confidence(diagnosis):
        text = f"Of answers like {'these' if several else 'this one'}, {shares} were right where the cause was known"
    else:
        answers = "these answers" if several else "this answer"
        text = f"Its own data, blocks drawn anew, give {answers} in {shares} of the draws"
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
    parts = [_shrink_of(diagnosis, stage, f"the {stage} stage's gap")]
    if stage != "chain":
        parts.append(_shrink_of(diagnosis, "chain", "the tip's over the whole chain"))
    parts = [part for part in parts if part]
    if not parts:
        return "How far the gap shrinks could not be measured on this data."
    floor = gap.floor.get(stage)
    last = f"; no {lacking(diagnosis)} is blamed for the last {quantity(floor.value, floor.unit)}" if floor else ""
    corrected = f"With {it} corrected in the {lacking(diagnosis)}"
    return f"{corrected}, {' and '.join(parts)}, {UNSEEN[diagnosis.held_out]}{last}."


def _shrink_of(diagnosis: Diagnosis, place: str, whose: str) -> str:
    gap = diagnosis.verdict.gap
    before, after = gap.before.get(place), gap.after.get(place)
    share = reduction(before, after)
    if before is None or after is None or share is None:
        return ""
    verb = "shrinks" if share >= 0 else "grows"
    return f"{whose} {verb} from {change(before, after, ' to ')} RMS ({less(diagnosis, place)})"


def _unknown(diagnosis: Diagnosis) -> tuple[str, str, str]:
    verdict, stage = diagnosis.verdict, diagnosis.verdict.where.stage
    before, ceiling = verdict.gap.before.get(stage or ""), verdict.gap.ceiling.get(stage or "")
    could = reduction(before, ceiling)
    where = f"in the {stage} stage" if stage else "between robot and simulator"
    regime = f" ({verdict.where.regime})" if verdict.where.regime else ""
    size = f" of {quantity(before.value, before.unit)} RMS" if before else ""
    what = f"There is a gap{size} {where}{regime}, and none of the known effects explains it."
    mine = [r for r in diagnosis.rivals if stage and any(name.startswith(f"{stage}.") for name in r.names)]
    best = max(mine or diagnosis.rivals, key=lambda r: r.alone, default=None)
    any_model = "some model could shrink it" if could is None else f"some model could take away {percent(could)} of it"
    seen = UNSEEN[diagnosis.held_out]
    sure = f"{seen[0].upper()}{seen[1:]}, {any_model}."
    if best is not None:
        closest, alone = " with ".join(best.names), max(0.0, best.alone)
        sure = f"{sure[:-1]}, while the known effect that comes closest, {closest}, takes away {percent(alone)}."
        if could is not None and alone > _AS_GOOD * could:
            sure = f"{sure[:-1]}: as much, and still it did not stand as the answer; warnings and rivals say more."
    feature = next((name for left in diagnosis.leftovers if left.stage == stage for name, _ in left.depends_on), None)
    hint = f"; what is left depends most on {feature}" if feature else ""
    return what, sure, f"So nothing is changed in the {lacking(diagnosis)}, and the gap stays as it is{hint}."


def _above(diagnosis: Diagnosis) -> bool:
    """Whether a stage stands above its floor."""
    return any(ratio > 1 for ratio in _in_floors(diagnosis).values())


def _in_floors(diagnosis: Diagnosis) -> dict[str, float]:
    """Stage -> its gap in floors, where there is one."""
    gap = diagnosis.verdict.gap
    found = {
        stage: times(gap.before[stage], gap.floor.get(stage)) for stage in stages_of(diagnosis) if stage in gap.before
    }
    return {stage: ratio for stage, ratio in found.items() if ratio is not None}


def _none(diagnosis: Diagnosis) -> tuple[str, str, str]:
    gap, known = diagnosis.verdict.gap, _in_floors(diagnosis)
    it = lacking(diagnosis)
    robot = "robot" if diagnosis.nominal is not None else "rig"
    if not known:
        return (
            f"No gap between {robot} and {it} was found on this data.",
            "No floor is known of any stage, so nobody says how small a gap could have been seen.",
            f"Nothing needs to change in the {it}; other excitations may still show a gap.",
        )
    stage = max(known, key=lambda name: known[name])
    left, floor, ratio = gap.before[stage], gap.floor[stage], known[stage]
    who = "the whole chain" if stage == "chain" else f"the {stage} stage"
    sizes_ = f"{quantity(left.value, left.unit)} RMS, where {quantity(floor.value, floor.unit)} count as none"
    if ratio <= 1:
        return (
            f"There is no gap beyond repeatability and noise: {robot} and {it} agree on this data.",
            f"Nearest to its floor is {who}: {sizes_}.",
            f"Nothing needs to change in the {it}; other excitations may still show a gap.",
        )
    return (
        f"No cause of a gap between {robot} and {it} was found on this data.",
        f"{who[0].upper()}{who[1:]} stands above its floor, at {number(ratio, 2)} times of it: {sizes_}; "
        "too little for this tool to blame anything, and not proof that nothing is there.",
        f"Nothing is changed in the {it}; larger, faster or longer excitations would show what is there.",
    )
