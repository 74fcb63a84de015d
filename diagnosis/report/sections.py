"""Sections that say what follows: the answer, the chain, the next experiment, the small print. Result in, HTML out."""

from collections.abc import Iterator

import numpy as np

from softarm.diagnosis.engine.result import Diagnosis, HeldOut
from softarm.diagnosis.report import causal, following
from softarm.diagnosis.report.answer import answer, headline, measured_confidence
from softarm.diagnosis.report.words import change, less, unit_of
from softarm.pages import charts
from softarm.pages.markup import Html, bar, el, join, prose, table, tiles
from softarm.pages.numbers import listed, number, percent, quantity
from softarm.schemas.excitation import Excitation
from softarm.schemas.verdict import NextExperiment
from softarm.simulator.model_rows import differences

_KINDS = {
    "named": "named: the named effects explain most of what any model could",
    "incomplete": "incomplete: the named effects are part of it, and more could be explained",
    "unknown": "unknown: something could be explained, and no known effect explains it",
    "none": "none: no cause of a gap was found",
}


_JUDGED: dict[HeldOut | None, str] = {
    "kind": "on the kinds of excitation that the fit has not seen, one kind left out at a time",
    "trial": "on trials that the fit has not seen; there is no kind of excitation that it has not seen",
    "block": "on stretches of the trials that the fit has not seen; it has seen other stretches of the same motions, "
    "so how it does on new motions is not measured",
    None: "on data that the fit has not seen",
}


def result(diagnosis: Diagnosis) -> Html:
    """The answer: headline, three sentences, the figures behind them."""
    kind = diagnosis.verdict.verdict
    lead = [el("p", prose(sentence)) for sentence in answer(diagnosis)]
    shown = kind.replace("_", " ") + (", not separable" if _sets(diagnosis) and kind in ("named", "incomplete") else "")
    chip = el("p", el("span", shown, class_=f"verdict {kind}", title=_KINDS.get(kind, shown)), class_="chip")
    title = el("h1", prose(headline(diagnosis)))
    return join([chip, title, el("div", *lead, class_="lead"), tiles(_figures(diagnosis)), _task(diagnosis)])


def _sets(diagnosis: Diagnosis) -> bool:
    """Whether every answer is a set."""
    return bool(diagnosis.verdict.effects) and all(effect.equivalents for effect in diagnosis.verdict.effects)


def _figures(diagnosis: Diagnosis) -> list[tuple[str, Html | str]]:
    verdict, gap = diagnosis.verdict, diagnosis.verdict.gap
    figures: list[tuple[str, Html | str]] = []
    sure = [effect.confidence for effect in verdict.effects if effect.confidence is not None]
    if sure:
        name = "confidence" if len(verdict.effects) == 1 else "confidence, the least sure"
        figures.append((name, percent(min(sure))))
    stage = verdict.where.stage
    for place, label in ((stage, f"{stage} gap"), ("chain", "tip, whole chain")):
        if place is None or place not in gap.before:
            continue
        before, after = gap.before[place], gap.after.get(place)
        if after is not None and (told := less(diagnosis, place)):
            figures.append((f"{label}, {told}", change(before, after)))
        else:
            figures.append((label, quantity(before.value, before.unit)))
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
    return table(("policy's success", "share"), rows, "How often the policy succeeds") if rows else Html("")


def chain(diagnosis: Diagnosis) -> Html:
    """Where in the causal chain the gap arises."""
    where = diagnosis.verdict.where
    if where.stage is None:
        told = "No stage stands out."
    else:
        told = f"The largest part of the gap arises in {where.stage}{f' ({where.regime})' if where.regime else ''}."
    drawn = el("div", causal.chain(diagnosis), class_="drawing", tabindex="0", role="region", aria_label="causal chain")
    note = "Each box: share of the gap; root mean square before → after the correction; the floor that counts as none."
    total = diagnosis.verdict.gap.before.get("chain")
    after = diagnosis.verdict.gap.after.get("chain")
    tip = ""
    if total is not None:
        told_tip = change(total, after) if after and diagnosis.verdict.effects else quantity(total.value, total.unit)
        tip = f"From commands alone to the tip: {told_tip}."
    return join([el("p", told), drawn, el("p", note, " ", tip, class_="hint")])


def next_step(diagnosis: Diagnosis) -> Html:
    """What would tell apart what this data cannot: the experiment that was asked for, and a line for every set."""
    flown, told = _flight(diagnosis), following.steps(diagnosis)
    parts = [*flown, *([el("ul", *(el("li", prose(text)) for text in told))] if told else [])]
    if not parts:
        return el("p", "This diagnosis asks for no further experiment.", class_="none")
    if told:
        parts.append(el("p", "Then diagnose again, with the new recording beside the old ones."))
    plan = diagnosis.verdict.next_experiment
    if plan is not None and len(set(plan.expect.values())) > 1 and not flown:
        parts.append(_expected(plan))
    return join(parts)


def _flight(diagnosis: Diagnosis) -> list[Html]:
    """The excitation to play, by which command, and what one would see."""
    plan, known = diagnosis.verdict.next_experiment, following.flight(diagnosis)
    if plan is None or known is None:
        return []
    apart = [", which tells apart ", prose(listed(plan.separates))] if plan.separates else []
    simulated = el("code", "softarm excite --plan verdict.json --simulated")
    then = ". Then diagnose again, with the new recording beside the old ones."
    parts = [
        el("p", "Play ", el("b", plan.excitation), f" ({known.description})", *apart, ":"),
        el("pre", "softarm excite --plan verdict.json --config softarm.yaml"),
        el("p", "On a simulated robot: ", simulated, then),
    ]
    if plan.expect:
        parts.append(_expected(plan))
    return [*parts, el("figure", el("figcaption", f"Commands of {known.name}"), _commands(known))]


def _expected(plan: NextExperiment) -> Html:
    rows = [(el("code", effect), prose(text)) for effect, text in plan.expect.items()]
    return table(("if the cause is", "one would see"), rows, "What the experiment would show")


def _commands(of: Excitation, samples: int = 600) -> Html:
    """What an excitation commands over time: pressure, and the cart's velocity where it moves."""
    t = np.linspace(0.0, of.duration_s, samples)
    velocity, pressure = np.array([of.at(float(s)) for s in t]).T
    curves = {"pressure (kPa)": pressure} if of.pressure_kpa else {}
    curves |= {"cart (m/s)": velocity} if of.moves_rail else {}
    return charts.lanes(t, curves, f"Commands of the excitation {of.name}: {of.description}")


def details(diagnosis: Diagnosis) -> Html:
    """The patch, nuisances, warnings, trials."""
    parts = [_patch(diagnosis)]
    if diagnosis.nuisances:
        rows = [
            (el("code", path), quantity(value, unit_of(diagnosis, path), 3))
            for path, value in diagnosis.nuisances.items()
        ]
        caption = "Nuisances: fitted beside every rival, within their tolerance; not blamed"
        parts += [el("h3", "Nuisances"), table(("parameter", "value"), rows, caption)]
    warnings = [el("li", prose(text)) for text in diagnosis.verdict.warnings]
    parts += [el("h3", "Warnings"), el("ul", *warnings) if warnings else el("p", "None.", class_="none")]
    trials = [(name, kind, f"{seconds:.1f} s") for name, kind, seconds in diagnosis.trials]
    parts += [el("h3", "Trials"), table(("trial", "excitation", "length"), trials, "What was read", numbers=(2,))]
    return join(parts)


def _patch(diagnosis: Diagnosis) -> Html:
    if diagnosis.nominal is None or diagnosis.patched is None:
        return Html("")
    rows = [
        (el("code", d.key), d.one, d.other, "" if d.unit == "-" else d.unit)
        for d in differences(diagnosis.nominal, diagnosis.patched)
    ]
    head = ("parameter", "nominal", "patched", "unit")
    return join([el("h3", "The patched model"), table(head, rows, "What the patch changes", numbers=(1, 2))])


def method(diagnosis: Diagnosis) -> Html:
    """How the answer was found: what was done in this run, and nothing else."""
    return el("p", " ".join(_method(diagnosis)))


def _method(diagnosis: Diagnosis) -> Iterator[str]:
    verdict, robot = diagnosis.verdict, diagnosis.nominal is not None
    yield "Every stage is simulated alone, driven by the signals measured before it."
    list_ = "Each effect of the registry" if robot else "Each effect that such a stage can have"
    beside = ", with small errors of what is known allowed beside it," if diagnosis.nuisances or robot else ""
    yield f"{list_} is fitted within bounds{beside} and judged {_JUDGED[diagnosis.held_out]}."
    yield "An effect is named for what it adds beside its rivals, never for what it does alone."
    if any(effect.parameters for effect in verdict.effects):
        yield "The 95 % interval of a fitted size is a jackknife over blocks of consecutive samples."
    if verdict.effects:
        yield "The 95 % interval of a shrink is a bootstrap: trials, or blocks of them, drawn anew."
    if verdict.gap.ceiling:
        yield "A flexible model of the residual says how much could be explained at all."
        yield "Where known effects fall short of that, the verdict is incomplete or unknown."
    if any(effect.confidence is not None for effect in verdict.effects):
        yield (
            "Confidence is how often such answers were right in cases of known cause."
            if measured_confidence(diagnosis)
            else "Confidence is how often these data, drawn anew, give the answer; no case of known cause is behind it."
        )
    kinds = {kind for _, kind, _ in diagnosis.trials}
    count, many = len(diagnosis.trials), len(kinds)
    read = (
        f"{count} trial{'s' * (count != 1)} of {many} kind{'s' * (many != 1)} {'was' if count == 1 else 'were'} read."
    )
    yield read
    if diagnosis.seconds > 0:
        yield f"This diagnosis took {number(diagnosis.seconds, 2)} s."
