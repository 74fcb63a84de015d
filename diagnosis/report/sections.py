"""Sections that say what follows: the answer, the chain, the next experiment, the small print. Result in, HTML out."""

import numpy as np

from softarm.diagnosis.engine.result import Diagnosis
from softarm.diagnosis.report import causal, evidence
from softarm.diagnosis.report.words import (
    answer,
    change,
    headline,
    meaning,
    percents,
    reduction,
    shrink_bounds,
    unit_of,
)
from softarm.pages import charts
from softarm.pages.markup import Html, bar, el, join, prose, table, tiles
from softarm.pages.numbers import listed, number, percent, quantity
from softarm.schemas.excitation import EXCITATIONS, Excitation
from softarm.simulator.model_rows import differences

_KINDS = {
    "named": "named: the named effects explain at least four fifths of what any model could",
    "incomplete": "incomplete: the named effects are part of it, and more could be explained",
    "unknown": "unknown: something could be explained, and no known effect explains it",
    "none": "none: no gap beyond repeatability and noise",
}


def result(diagnosis: Diagnosis) -> Html:
    """The answer: headline, three sentences, the figures behind them."""
    kind = diagnosis.verdict.verdict
    lead = [el("p", prose(sentence)) for sentence in answer(diagnosis)]
    chip = el("p", el("span", kind, class_=f"verdict {kind}", title=_KINDS[kind]), class_="chip")
    title = el("h1", prose(headline(diagnosis)))
    return join([chip, title, el("div", *lead, class_="lead"), tiles(_figures(diagnosis)), _task(diagnosis)])


def _figures(diagnosis: Diagnosis) -> list[tuple[str, Html | str]]:
    verdict, gap = diagnosis.verdict, diagnosis.verdict.gap
    figures: list[tuple[str, Html | str]] = []
    if verdict.effects:
        name = "confidence" if len(verdict.effects) == 1 else "confidence, the least sure"
        figures.append((name, percent(min(effect.confidence for effect in verdict.effects))))
    stage = verdict.where.stage
    for place, label in ((stage, f"{stage} gap"), ("chain", "tip, whole chain")):
        if place is None or place not in gap.before:
            continue
        before, after = gap.before[place], gap.after.get(place)
        if after is not None and verdict.effects:
            share = reduction(before, after)
            if share is not None:
                bounds = shrink_bounds(diagnosis) if place == stage else ""
                label += f", {percent(abs(share))} {'less' if share >= 0 else 'more'}{bounds}"
            figures.append((label, change(before, after)))
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
        told = f"The largest part of the gap arises in {where.stage}" + (f": {where.regime}." if where.regime else ".")
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
    """The experiment that tells apart what this data cannot."""
    plan = diagnosis.verdict.next_experiment
    if plan is None:
        return el("p", "This diagnosis asks for no further experiment.", class_="none")
    known = EXCITATIONS.get(plan.excitation)
    rows = [(el("code", effect), prose(text)) for effect, text in plan.expect.items()]
    what = f" ({known.description})" if known else ""
    apart = [", which tells apart ", prose(listed(plan.separates))] if plan.separates else []
    simulated = el("code", "softarm excite --plan verdict.json --simulated")
    then = ". Then diagnose again, with the new recording beside the old ones."
    parts = [
        el("p", "Play ", el("b", plan.excitation), what, *apart, ":"),
        el("pre", "softarm excite --plan verdict.json --config softarm.yaml"),
        el("p", "On a simulated robot: ", simulated, then),
    ]
    if rows:
        parts.append(table(("if the cause is", "one would see"), rows, "What the experiment would show"))
    if known is not None:
        parts.append(el("figure", el("figcaption", f"Commands of {known.name}"), _commands(known)))
    return join(parts)


def _commands(of: Excitation, samples: int = 600) -> Html:
    """What an excitation commands over time: pressure, and the cart's velocity where it moves."""
    t = np.linspace(0.0, of.duration_s, samples)
    velocity, pressure = np.array([of.at(float(s)) for s in t]).T
    curves = {"pressure (kPa)": pressure} if of.pressure_kpa else {}
    curves |= {"cart (m/s)": velocity} if of.moves_rail else {}
    return charts.lanes(t, curves, f"Commands of the excitation {of.name}: {of.description}")


def details(diagnosis: Diagnosis) -> Html:
    """Named effects, the patch, nuisances, warnings, trials."""
    parts = [_named(diagnosis), evidence.parameters(diagnosis), _patch(diagnosis)]
    if diagnosis.nuisances:
        rows = [
            (el("code", path), quantity(value, unit_of(path, diagnosis.units), 3))
            for path, value in diagnosis.nuisances.items()
        ]
        caption = "Nuisances: fitted beside every rival, within their tolerance; not blamed"
        parts += [el("h3", "Nuisances"), table(("parameter", "value"), rows, caption)]
    warnings = [el("li", prose(text)) for text in diagnosis.verdict.warnings]
    parts += [el("h3", "Warnings"), el("ul", *warnings) if warnings else el("p", "None.", class_="none")]
    trials = [(name, kind, f"{seconds:.1f} s") for name, kind, seconds in diagnosis.trials]
    parts += [el("h3", "Trials"), table(("trial", "excitation", "length"), trials, "What was read", numbers=(2,))]
    return join(parts)


def _named(diagnosis: Diagnosis) -> Html:
    rows = [
        (
            el("code", e.name),
            prose(meaning(e.name)),
            percent(e.confidence),
            join([el("code", other) for other in e.equivalents], " ") if e.equivalents else "–",
            percents(e.shrink.stage),
            percents(e.shrink.chain) if e.shrink.chain else "–",
        )
        for e in diagnosis.verdict.effects
    ]
    head = ("effect", "what it is", "confidence", "cannot be told from", "shrinks its stage by", "shrinks the chain by")
    caption = "Named effects, in order of what each adds beside the others; held out, 95 %"
    return join([el("h3", "Named effects"), table(head, rows, caption)]) if rows else Html("")


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
    """How the answer was found, in a few sentences."""
    kinds = len({kind for _, kind, _ in diagnosis.trials})
    spent = f" This diagnosis took {number(diagnosis.seconds, 2)} s." if diagnosis.seconds > 0 else ""
    return el(
        "p",
        "Every stage is simulated alone, driven by the signals measured before it. Each effect of the registry is "
        "fitted within physical bounds, with small errors of every known parameter allowed beside it, and judged on "
        "excitations that the fit has not seen; an effect is named for what it adds beside its rivals, never for what "
        "it does alone. Intervals are 95 %, by resampling blocks of consecutive samples. A flexible model of the "
        "residual says how much could be explained at all; where the named effects fall short of that, the verdict "
        "says so. Confidence is how often such answers were right in cases of known cause."
        f" {len(diagnosis.trials)} trials of {kinds} kinds were read.{spent}",
    )
