"""Report sections on the answer, the causal chain, the next experiment and the details."""

from collections.abc import Iterator

import numpy as np

from softarm.diagnosis.engine.result import Diagnosis, HeldOut
from softarm.diagnosis.report import causal, following
from softarm.diagnosis.report.answer import LISTED_MAX, NOT_RATED, answer, equal_sets, headline
from softarm.diagnosis.report.words import (
    alternatives,
    calibration_in_words,
    corrected,
    entries,
    interval,
    percents,
    plain,
    sentence,
    shrinks_by,
    sizes,
    tolerance,
)
from softarm.reporting import charts
from softarm.reporting.markup import Html, bar, el, join, prose, table, tiles
from softarm.reporting.numbers import listed, number, percent, quantity
from softarm.schemas.excitation import Excitation
from softarm.schemas.verdict import NamedEffect, NextExperiment
from softarm.simulator.model_file import differences

_KINDS = {
    "named": "named: the named effects explain most of the explainable gap",
    "incomplete": "incomplete: the named effects explain a part, and more could be explained",
    "unknown": "unknown: part of the gap could be explained, but by no known effect",
    "none": "none: no cause of a gap was found",
}


_VALIDATION: dict[HeldOut | None, str] = {
    "kind": "on held-out kinds of excitation, one kind at a time",
    "trial": "on held-out trials; no kind of excitation was held out",
    "block": "on held-out stretches of the same trials; the error on new motions was not measured",
    None: "on held-out data",
}


def result(diagnosis: Diagnosis) -> Html:
    """Return the first screen: one sentence, a card for each cause, the chain, the figures and the calibration."""
    kind = diagnosis.verdict.verdict
    named = diagnosis.verdict.causes
    causes = [_card(diagnosis, effect) for effect in named] if len(named) <= LISTED_MAX else []
    lead = [equal_sets(diagnosis), calibration_in_words(diagnosis)] if causes else answer(diagnosis)
    shown = kind + (", not separable" if named and all(effect.equivalents for effect in named) else "")
    chip = el("p", el("span", shown, class_=f"verdict {kind}", title=_KINDS[kind]), class_="chip")
    title = el("h1", prose(headline(diagnosis)))
    cards = el("div", *causes, class_="cards") if causes else Html("")
    paragraphs = el("div", *(el("p", prose(text)) for text in lead if text), class_="lead")
    first, second = (_chain(diagnosis), paragraphs) if causes else (paragraphs, _chain(diagnosis))
    return join([chip, title, cards, first, tiles(_figures(diagnosis)), second, _task(diagnosis)])


def _card(diagnosis: Diagnosis, effect: NamedEffect) -> Html:
    """Return the card of a cause: its sentence, size, confidence, and share of the gap."""
    own = entries(diagnosis, effect)
    codes = ", or ".join((listed([each.name for each in own]), *alternatives(effect)))
    shares = [f"{percents(each.shrink.stage)} of the {each.name.rpartition('.')[0]} gap" for each in own]
    takes = f"takes {listed(shares)}"
    tip, at_tip = diagnosis.verdict.gap.before.get("chain"), effect.shrink.chain
    if tip is not None and at_tip is not None:
        takes += f", {percents(at_tip)} of the tip's ({quantity(at_tip.value * tip.value, tip.unit)})"
    sure = NOT_RATED if effect.confidence is None else percent(effect.confidence)
    facts = (prose(codes), sizes(effect), takes, f"confidence: {sure}")
    return el(
        "article",
        el("h2", prose(sentence(plain(diagnosis, effect)))),
        *(el("p", fact, class_="soft" if i != 1 else None) for i, fact in enumerate(facts) if fact),
        class_="card",
    )


def _figures(diagnosis: Diagnosis) -> list[tuple[str, Html | str]]:
    verdict, gap = diagnosis.verdict, diagnosis.verdict.gap
    figures: list[tuple[str, Html | str]] = []
    stage = verdict.where.stage
    for place, label in ((stage, f"{stage} gap"), ("chain", "tip, whole chain")):
        if place is None or place not in gap.before:
            continue
        shrunk = shrinks_by(diagnosis, place)
        figures.append((f"{label}, {shrunk}" if shrunk else label, corrected(diagnosis, place)))
    if stage in verdict.where.share:
        figures.append((f"of the gap in {stage}", percent(verdict.where.share[stage])))
    return figures


def _task(diagnosis: Diagnosis) -> Html:
    task = diagnosis.verdict.task
    if task is None:
        return Html("")
    given = (
        ("on the robot", task.success_real, "measured"),
        ("in the nominal simulator", task.success_nominal, "nominal"),
        ("in the patched simulator", task.success_patched, "patched"),
    )
    rows = [(name, bar(share, kind, percent(share))) for name, share, kind in given if share is not None]
    return table(("success of the policy", "share"), rows, "How often the policy succeeds") if rows else Html("")


def _chain(diagnosis: Diagnosis) -> Html:
    where = diagnosis.verdict.where
    lead = "No stage stands out."
    if where.stage is not None:
        lead = f"The largest part of the gap arises in {where.stage} ({where.regime})."
    drawn = el("div", causal.chain(diagnosis), class_="drawing", tabindex="0", role="region", aria_label="causal chain")
    note = (
        "Each box: share of the gap; RMS before → after the correction; noise floor. "
        "The share compares squared gaps, each in units of its stage's noise floor."
    )
    tip = ""
    if "chain" in diagnosis.verdict.gap.before:
        tip = f"Tip, simulated from commands alone: {corrected(diagnosis, 'chain')}."
    return join([el("p", lead), drawn, el("p", note, " ", tip, class_="hint")])


def next_step(diagnosis: Diagnosis) -> Html:
    """Return the section on the next experiment and on separating each set of effects."""
    planned, further = _flight(diagnosis), following.steps(diagnosis)
    parts = [*planned, *([el("ul", *(el("li", prose(text)) for text in further))] if further else [])]
    if not parts:
        return el("p", "No further experiment is needed.", class_="none")
    if further:
        parts.append(el("p", "Then diagnose the old and the new recordings together."))
    plan = diagnosis.verdict.next_experiment
    if plan is not None and len(set(plan.expect.values())) > 1 and not planned:
        parts.append(_expected(plan))
    return join(parts)


def _flight(diagnosis: Diagnosis) -> list[Html]:
    """Return the excitation to play, its command, and the expected results."""
    plan, known = diagnosis.verdict.next_experiment, following.flight(diagnosis)
    if plan is None or known is None:
        return []
    purpose = [" to separate ", prose(listed(plan.separates))] if plan.separates else []
    simulated = el("code", "softarm excite --plan verdict.json --simulated")
    parts = [
        el("p", "Play ", el("b", plan.excitation), f" ({known.description})", *purpose, ":"),
        el("pre", "softarm excite --plan verdict.json --config softarm.yaml"),
        el("p", "On a simulated robot: ", simulated, ". Then diagnose the old and the new recordings together."),
    ]
    if plan.expect:
        parts.append(_expected(plan))
    return [*parts, el("figure", el("figcaption", f"Commands of {known.name}"), _commands(known))]


def _expected(plan: NextExperiment) -> Html:
    rows = [(el("code", effect), prose(text)) for effect, text in plan.expect.items()]
    return table(("if the cause is", "expected result"), rows, "Expected result of the experiment by cause")


def _commands(of: Excitation) -> Html:
    t = np.linspace(0.0, of.duration_s, 600)
    velocity, pressure = np.array([of.at(float(s)) for s in t]).T
    curves = {"pressure (kPa)": pressure} if of.pressure_kpa else {}
    curves |= {"cart (m/s)": velocity} if of.moves_rail else {}
    return charts.lanes(t, curves, f"Commands of the excitation {of.name}: {of.description}")


def calibration(diagnosis: Diagnosis) -> Html:
    """Return the section on the nominal model's own parameters, and the gap that is left with all of them."""
    verdict = diagnosis.verdict
    lead = el("p", prose(calibration_in_words(diagnosis)))
    if not verdict.calibration:
        return lead
    rows = [
        (
            el("code", each.name),
            quantity(each.nominal, each.unit, 3),
            interval(each, each.unit),
            tolerance(each),
            percent(max(each.shrink, 0.0)),
        )
        for each in verdict.calibration
    ]
    head = ("parameter", "nominal", "fitted, 95 % interval", "tolerance", "takes of its stage's gap")
    caption = "Parameters of the nominal model that the data resolve; of single joints the relative change"
    return join([lead, table(head, rows, caption, numbers=(4,)), _gaps(diagnosis)])


def _gaps(diagnosis: Diagnosis) -> Html:
    """Return each stage's gap: nominal, with the effects, calibrated as well, and the ceiling."""
    gap, rows = diagnosis.verdict.gap, []
    for stage, before in gap.before.items():
        others = [gap.after.get(stage) if diagnosis.verdict.effects else None, gap.calibrated.get(stage)]
        cells = [quantity(each.value, each.unit) if each else "–" for each in (before, *others, gap.ceiling.get(stage))]
        rows.append((stage, *cells))
    head = ("stage", "nominal", "with effects", "and calibrated", "flexible model")
    return table(head, rows, "RMS gap of each stage, held out", numbers=(1, 2, 3, 4))


def details(diagnosis: Diagnosis) -> Html:
    """Return the section with the patch, warnings and trials."""
    parts = [_patch(diagnosis)]
    warnings = [el("li", prose(text)) for text in diagnosis.verdict.warnings]
    parts += [el("h3", "Warnings"), el("ul", *warnings) if warnings else el("p", "None.", class_="none")]
    trials = [(name, kind, f"{seconds:.1f} s") for name, kind, seconds in diagnosis.trials]
    parts += [el("h3", "Trials"), table(("trial", "excitation", "length"), trials, "Recordings used", numbers=(2,))]
    return join(parts)


def _patch(diagnosis: Diagnosis) -> Html:
    if diagnosis.nominal is None or diagnosis.patched is None:
        return Html("")
    rows = [
        (el("code", d.key), d.one, d.other, "" if d.unit == "-" else d.unit)
        for d in differences(diagnosis.nominal, diagnosis.patched)
    ]
    head = ("parameter", "nominal", "patched", "unit")
    return join([el("h3", "The patched model"), table(head, rows, "Changes in the patch", numbers=(1, 2))])


def method(diagnosis: Diagnosis) -> Html:
    """Return the description of the steps that this diagnosis took."""
    return el("p", " ".join(_method(diagnosis)))


def _method(diagnosis: Diagnosis) -> Iterator[str]:
    verdict, robot = diagnosis.verdict, diagnosis.nominal is not None
    yield "Each stage is simulated alone, driven by the signals measured before it."
    effects = "Each effect of the registry" if robot else "Each effect that such a stage can have"
    yield f"{effects} is fitted within bounds and scored {_VALIDATION[diagnosis.held_out]}."
    yield "Every fit includes the nuisance parameters: small errors of known quantities, within tolerance."
    yield "An effect is named for its unique contribution next to its rivals, not for its fit alone."
    if any(effect.parameters for effect in verdict.effects):
        own = ", widened by the tolerance of a well-kept robot" if robot else ""
        yield f"The 95 % interval of a fitted size is a jackknife over blocks of consecutive samples{own}."
    if verdict.effects:
        yield "The 95 % interval of a shrink is a bootstrap over trials, or over blocks of one trial."
    if verdict.gap.ceiling:
        yield "A flexible model of the residual estimates how much of the gap could be explained at all."
        yield "If known effects explain clearly less, the verdict is incomplete or unknown."
    if any(effect.confidence is not None for effect in verdict.effects):
        yield "Confidence is the share of correct answers in blind tests with known causes."
    count, many = len(diagnosis.trials), len({kind for _, kind, _ in diagnosis.trials})
    kinds = f"{many} kind{'s' * (many != 1)} of excitation"
    yield f"{count} trial{'s' * (count != 1)} with {kinds} {'was' if count == 1 else 'were'} read."
    if diagnosis.seconds > 0:
        yield f"The diagnosis took {number(diagnosis.seconds, 2)} s."
