"""Headline and summary of a diagnosis: the cause, the confidence, and how far the gap shrinks."""

from collections.abc import Sequence

from softarm.diagnosis.data.trials import STAGE_NEEDS
from softarm.diagnosis.engine.result import Diagnosis
from softarm.diagnosis.report.words import (
    HELD_OUT,
    calibration_in_words,
    described,
    model_word,
    name_of,
    noise_level,
    one_of,
    plain,
    reduction,
    relation,
    sentence,
    shrinks,
    sized,
    stages_of,
    stages_with,
)
from softarm.reporting.numbers import listed, number, percent, quantity
from softarm.schemas.verdict import NamedEffect

_AS_GOOD = 0.9  # share of the flexible model's improvement: an effect that reaches it failed for another reason
LOUD = 3.0  # multiple of the noise of a stage's signals from which what its model leaves is stated first
LISTED_MAX = 4  # effects in a headline; more are counted
NOT_RATED = "not rated"


def answer(diagnosis: Diagnosis) -> tuple[str, str, str]:
    """Return the cause, its confidence, and how far the gap shrinks, as three short texts."""
    kind = diagnosis.verdict.verdict
    if kind == "none":
        return _none(diagnosis)
    if kind == "unknown":
        return _unknown(diagnosis)
    return _cause(diagnosis), _how_sure(diagnosis), _shrinks(diagnosis)


def equal_sets(diagnosis: Diagnosis) -> str:
    """Return the other sets of effects that explain as much as the named ones, or an empty string."""
    sets = [" with ".join(names) for names in diagnosis.verdict.equal_sets]
    return f"The recordings fit as well: {listed(sets, 'or')}." if sets else ""


def headline(diagnosis: Diagnosis) -> str:
    """Return the answer as one sentence that a technician understands."""
    verdict = diagnosis.verdict
    if verdict.verdict == "none":
        is_open = max(_in_floors(diagnosis).values(), default=0.0) > 1 or _loudest(diagnosis) is not None
        return "No cause found" if is_open else "No gap"
    if verdict.verdict == "unknown":
        return f"An unknown effect in {verdict.where.stage}" if verdict.where.stage else "An unknown effect"
    more = ", and more is missing" if verdict.verdict == "incomplete" else ""
    if sum(1 + len(effect.equivalents) for effect in verdict.causes) > LISTED_MAX:
        return f"{_counted(verdict.causes)}{more}"
    texts = _singles_first(verdict.causes, [plain(diagnosis, effect) for effect in verdict.causes])
    return sentence(f"{', '.join(texts[:-1])}, and {texts[-1]}" if len(texts) > 1 else texts[0]) + more


def _counted(effects: Sequence[NamedEffect]) -> str:
    """Return `3 effects in servo1`, `26 effects in 6 stages` or `One of 5 effects in servo1`."""
    stages = sorted({stage for effect in effects for stage in stages_with(effect)})
    where = stages[0] if len(stages) == 1 else f"{len(stages)} stages"
    if len(effects) == 1:
        return f"One of {1 + len(effects[0].equivalents)} effects in {where}"
    sets = ", each with alternatives" if all(effect.equivalents for effect in effects) else ""
    return f"{len(effects)} effects in {where}{sets}"


def _singles_first(effects: Sequence[NamedEffect], texts: Sequence[str]) -> list[str]:
    pairs = list(zip(effects, texts, strict=True))
    return [t for e, t in pairs if not e.equivalents] + [t for e, t in pairs if e.equivalents]


def _cause(diagnosis: Diagnosis) -> str:
    named = diagnosis.verdict.causes
    more = " More of the gap could be explained." if diagnosis.verdict.verdict == "incomplete" else ""
    if diagnosis.verdict.equal_sets:
        more += f" {equal_sets(diagnosis)}"
    if len(named) > LISTED_MAX:
        return f"Missing in the {model_word(diagnosis)}, {_counted(named)}: {_by_law(named)}.{more}"
    groups: dict[str, list[NamedEffect]] = {}
    for effect in named:
        groups.setdefault(relation(diagnosis, effect), []).append(effect)
    sentences = [f"{how[0].upper()}{how[1:]}: {_listed(diagnosis, effects)}." for how, effects in groups.items()]
    return " ".join(sentences) + more


def _listed(diagnosis: Diagnosis, effects: Sequence[NamedEffect]) -> str:
    """Return effects with their sizes, sets of indistinguishable effects last."""
    if len(effects) == 1 and not effects[0].equivalents:
        return described(diagnosis, effects[0])
    texts = [one_of(effect) if effect.equivalents else sized(effect) for effect in effects]
    *head, last = _singles_first(effects, texts)
    return f"{', '.join(head)}, and {last}" if head and last.startswith("either") else listed((*head, last))


def _by_law(effects: Sequence[NamedEffect]) -> str:
    """Return effects grouped by law, such as `lag (servo1 and servo2), deadband or backlash (servo1)`."""
    found: dict[str, list[str]] = {}
    for effect in effects:
        laws = sorted(name.rpartition(".")[2] for name in (effect.name, *effect.equivalents))
        found.setdefault(listed(laws, "or"), []).extend(stages_with(effect))
    common = sorted(found.items(), key=lambda item: (-len(item[1]), item[0]))
    return ", ".join(f"{law} ({listed(sorted(stages))})" for law, stages in common)


def _how_sure(diagnosis: Diagnosis) -> str:
    verdict = diagnosis.verdict
    rated = sorted(round(100 * e.confidence) for e in verdict.causes if e.confidence is not None)
    unrated = [effect.name for effect in verdict.causes if effect.confidence is None]
    if not rated:
        text = "The confidence of this answer has not been measured"
    else:
        shares = f"{rated[0]}–{rated[-1]} %" if rated[0] < rated[-1] else f"{rated[0]} %"
        text = f"In blind tests, {shares} of such answers were correct"
        text += f"; {NOT_RATED}: {listed(unrated)}" if unrated else ""
    stage = verdict.where.stage or ""
    share = percent(verdict.where.share[stage])
    return f"{text}. {share} of the gap arises in the {stage} stage ({verdict.where.regime})."


def _shrinks(diagnosis: Diagnosis) -> str:
    gap, worst = diagnosis.verdict.gap, diagnosis.verdict.where.stage or ""
    one, *more = diagnosis.verdict.causes
    share, caused = diagnosis.verdict.where.share, {s for each in (one, *more) for s in stages_with(each)}
    stage = worst if worst in caused else max(sorted(caused), key=lambda name: share.get(name, 0.0))
    it = "all of them" if more else name_of(one) if one.equivalents else "it"
    places = [(stage, f"the gap of the {stage} stage")]
    if stage != "chain":
        places.append(("chain", "the gap at the tip"))
    parts = [f"{whose} {shrinks(diagnosis, place)}" for place, whose in places if place in gap.before]
    if not parts:
        return "The shrink of the gap could not be measured on this data."
    noise = f" In the {stage} stage, {noise_level(gap.floor[stage])}." if stage in gap.floor else ""
    corrected = f"With {it} corrected in the {model_word(diagnosis)}"
    left = "" if stage == worst else f" No effect is named for the {worst} stage."
    return f"{corrected}, {' and '.join(parts)}, {HELD_OUT[diagnosis.held_out]}.{noise}{left}"


def _unknown(diagnosis: Diagnosis) -> tuple[str, str, str]:
    verdict, stage = diagnosis.verdict, diagnosis.verdict.where.stage or ""
    before, ceiling = verdict.gap.before.get(stage), verdict.gap.ceiling.get(stage)
    could = reduction(before, ceiling)
    size = f" of {quantity(before.value, before.unit)} RMS" if before else ""
    where = f"in the {stage} stage ({verdict.where.regime})" if stage else "between robot and simulator"
    cause = f"There is a gap{size} {where}. No known effect explains it."
    mine = [rival for rival in diagnosis.rivals if rival.name.startswith(f"{stage}.")]
    best = max(mine or diagnosis.rivals, key=lambda r: r.alone, default=None)
    held_out = HELD_OUT[diagnosis.held_out]
    sure = f"{held_out[0].upper()}{held_out[1:]}, a flexible model could remove "
    sure += "part of it." if could is None else f"{percent(could)} of it."
    if best is not None:
        alone = max(0.0, best.alone)
        sure += f" The closest known effect, {best.name}, removes {percent(alone)}."
        if could is not None and alone > _AS_GOOD * could:
            sure += " That is as much, but it failed other checks; see the warnings and the rivals."
    feature = next((name for left in diagnosis.unexplained if left.stage == stage for name, _ in left.depends_on), None)
    hint = f" The residual depends most on {feature}." if feature else ""
    return cause, sure, f"The {model_word(diagnosis)} stays unchanged, and the gap remains.{hint}"


def _in_floors(diagnosis: Diagnosis) -> dict[str, float]:
    """Return each stage's gap in multiples of its noise floor."""
    before, floor = diagnosis.verdict.gap.before, diagnosis.verdict.gap.floor
    return {stage: before[stage].value / floor[stage].value for stage in stages_of(diagnosis) if stage in before}


def _loudest(diagnosis: Diagnosis) -> str | None:
    """Return the stage whose model leaves most above the noise of its signals, or None if that is little."""
    noise = diagnosis.noise
    loudest = max(noise, key=lambda stage: noise[stage], default=None)
    return loudest if loudest is not None and noise[loudest] > LOUD else None


def _none(diagnosis: Diagnosis) -> tuple[str, str, str]:
    gap, known = diagnosis.verdict.gap, _in_floors(diagnosis)
    it = model_word(diagnosis)
    robot = "robot" if diagnosis.nominal is not None else "rig"
    calibrated = f" {calibration_in_words(diagnosis)}" if diagnosis.verdict.calibration else ""
    not_found = f"No cause of a gap between {robot} and {it} was found on this data."
    unchanged = f"No effect is added to the {it}. Larger, faster or longer excitations would show more.{calibrated}"
    if (loudest := _loudest(diagnosis)) is not None:
        left = gap.floor[loudest]
        return (
            not_found,
            f"The {loudest} stage leaves {quantity(left.value, left.unit)} RMS, {number(diagnosis.noise[loudest], 2)} "
            "times the noise of its signals. Nothing that was recorded explains it: noise, or a disturbance from "
            "outside, such as a cable or a contact.",
            unchanged,
        )
    stage = max(known, key=lambda name: known[name])
    left, floor, ratio = gap.before[stage], gap.floor[stage], known[stage]
    place = "the whole chain" if stage == "chain" else f"the {stage} stage"
    size = f"{quantity(left.value, left.unit)} RMS; {noise_level(floor)}"
    if ratio <= 1:
        nothing = f"Nothing is missing in the {it}."
        if robot == "robot" and (absent := [name for name in STAGE_NEEDS if name not in known]):
            nothing = f"The recordings do not show {listed(absent)}. In the other stages, nothing is missing."
        return (
            f"No gap beyond noise: {robot} and {it} agree on this data.",
            f"Closest to its noise floor is {place} with {size}.",
            f"{nothing} Other excitations may still show a gap.{calibrated}",
        )
    return (
        not_found,
        f"{place[0].upper()}{place[1:]} is at {number(ratio, 2)} times its noise floor: {size}. "
        "That is too little to attribute to an effect, and no proof that the gap is zero.",
        unchanged,
    )
