"""Report sections with the evidence: overlays, spectra, regimes, rivals and the remaining gap."""

from collections.abc import Callable, Sequence
from typing import TypeVar

from softarm.common.words import numbered
from softarm.diagnosis.answer.worst import window, worst
from softarm.diagnosis.engine.result import Diagnosis, Regime, Rival, Spectrum
from softarm.diagnosis.report.words import percents, unit_of
from softarm.reporting import charts, plot
from softarm.reporting.markup import Html, bar, el, join, legend, prose, table
from softarm.reporting.numbers import number, percent, quantity

Row = TypeVar("Row")
_CHOICES = ("stage", "trial", "channel")
_AT_ONCE = 20  # rows of a table


def traces(diagnosis: Diagnosis) -> Html:
    """Return the section with measured, nominal and patched signals over time."""
    if not diagnosis.overlays:
        return el("p", "No recordings to draw.", class_="none")
    shown = _traces(diagnosis)
    kinds = max((list(one.curves) for one in shown), key=len)
    every = plot.every(shown)
    thin = f" One of {every} samples is drawn, to keep the page small." if every > 1 else ""
    text = (
        "Each stage is simulated alone, driven by the signals measured before it. "
        f"The lower strip is measured minus simulated; its grey band is the stage's noise floor.{thin}"
    )
    drawn = plot.charts(_CHOICES, kinds, "measured and simulated signals over time")
    return join([el("p", text), drawn])


def packed(diagnosis: Diagnosis) -> dict[str, object]:
    """Return the page's plot data, opened at the largest gap."""
    at = worst(diagnosis)
    view = window(diagnosis.overlays[at]) if diagnosis.overlays else None
    return plot.packed(_CHOICES, _traces(diagnosis), at, view)


def _traces(diagnosis: Diagnosis) -> list[plot.Traces]:
    """Return the measured and simulated curves of every stage, trial and channel, with the noise floor."""
    found, overlays = [], diagnosis.overlays
    trials = numbered((each.trial for each in overlays), ((each.stage, each.channel) for each in overlays))
    for each, trial in zip(overlays, trials, strict=True):
        curves = {"measured": each.measured, "nominal": each.nominal}
        curves |= {"patched": each.patched} if each.patched is not None else {}
        curves |= {"calibrated": each.calibrated} if each.calibrated is not None else {}
        chosen, floor = (each.stage, trial, each.channel), diagnosis.verdict.gap.floor[each.stage].value
        found.append(plot.Traces(chosen, each.kind, each.unit, each.t_s, curves, floor))
    return found


def frequencies(diagnosis: Diagnosis) -> Html:
    """Return the section with the residual by frequency and by regime."""
    drawn = [(s, drawing) for s in diagnosis.spectra if (drawing := _spectrum(s)) is not None]
    figures = [el("figure", el("figcaption", el("b", s.stage), f"  {s.unit}/√Hz"), drawing) for s, drawing in drawn]
    patched = any(s.patched is not None for s, _ in drawn)
    parts: list[Html] = []
    if figures:
        parts += [
            el("p", "Amplitude density of measured minus simulated; all trials and channels of a stage together."),
            legend(*(("nominal", "patched") if patched else ("nominal",)), "floor"),
            el("div", *figures, class_="multiples"),
        ]
    if diagnosis.regimes:
        stage = diagnosis.verdict.where.stage
        parts += [el("h3", "By regime"), *_folded(diagnosis.regimes, lambda regime: regime.stage == stage, _regimes)]
    return join(parts) if parts else el("p", "No spectra were computed.", class_="none")


def _spectrum(of: Spectrum) -> Html | None:
    curves = {"nominal": of.nominal} if of.patched is None else {"nominal": of.nominal, "patched": of.patched}
    text = f"Residual amplitude density of {of.stage} in {of.unit} per root hertz over frequency"
    return charts.spectrum(of.frequency_hz, curves, of.floor, text)


def _folded(rows: Sequence[Row], is_first: Callable[[Row], bool], draw: Callable[[Sequence[Row]], Html]) -> list[Html]:
    """Return a table of all rows, or of many rows those of the diagnosed stage and a collapsed table of the others."""
    shown, rest = [row for row in rows if is_first(row)], [row for row in rows if not is_first(row)]
    if len(rows) <= _AT_ONCE or not shown or not rest:
        return [draw(rows)]
    return [draw(shown), el("details", el("summary", f"other stages: {len(rest)} more rows"), draw(rest))]


def _regimes(regimes: Sequence[Regime]) -> Html:
    patched = any(regime.patched_rms is not None for regime in regimes)
    most: dict[str, float] = {}
    for regime in regimes:
        most[regime.stage] = max(most.get(regime.stage, 0.0), regime.nominal_rms, regime.patched_rms or 0.0)

    def cell(regime: Regime, value: float | None, kind: str) -> Html:
        if value is None:
            return Html("–")
        return bar(value / (most[regime.stage] or 1.0), kind, quantity(value, regime.unit))

    rows = []
    for r in regimes:
        row = [r.stage, r.name, f"{r.samples:,}".replace(",", " "), cell(r, r.nominal_rms, "nominal")]
        rows.append([*row, cell(r, r.patched_rms, "patched")] if patched else row)
    head = ["stage", "regime", "samples", "nominal", *(["patched"] if patched else [])]
    caption = "Residual by regime, RMS; bars are relative to the largest value of their stage"
    return table(head, rows, caption, numbers=(2,))


def contenders(diagnosis: Diagnosis) -> Html:
    """Return the section with every effect that was tried as the cause."""
    if not diagnosis.rivals:
        return el("p", "No effect was tried.", class_="none")
    forest = charts.Forest([rival.conditional for rival in diagnosis.rivals])
    head = ("effect", "alone", join(["next to the named ones, percent", forest.axis()]), "fitted", "note")
    robot = diagnosis.nominal is not None
    base = "of the gain of the named effect" if robot else "of the gap that remains without it"
    caption = f"Effects tried as the cause; alone: share of the stage's gap; next to the named ones: share {base}"

    def drawn(rivals: Sequence[Rival]) -> Html:
        return el("div", table(head, [_rival(diagnosis, rival, forest) for rival in rivals], caption), class_="rivals")

    stage = diagnosis.verdict.where.stage
    text = (
        "Alone, a wrong effect can fit as well as the right one. The second figure decides: the gain of an effect "
        "next to the named ones, with its 95 % interval. An interval that excludes zero is a real gain."
    )
    tables = _folded(diagnosis.rivals, lambda rival: rival.name.startswith(f"{stage}."), drawn)
    return join([el("p", prose(text)), *tables])


def _rival(diagnosis: Diagnosis, rival: Rival, forest: charts.Forest) -> tuple[Html, ...]:
    fitted = []
    for path, value in rival.parameters.items():
        text = f"{path.rpartition('.')[2]} {quantity(value, unit_of(diagnosis, path), 3)}"
        fitted.append(el("span", text, title=path, class_="fit"))
    share = percents(rival.conditional)
    added = el("span", forest.row(rival.conditional, share), el("span", share, class_="num"), class_="forestcell")
    note = el("span", prose(rival.note), class_="tag named" if rival.note == "named" else None)
    return el("code", rival.name), bar(rival.alone, "plain", percent(rival.alone)), added, join(fitted), note


def left(diagnosis: Diagnosis) -> Html:
    """Return the section with the remaining gap of each stage, and the signals that it depends on."""
    gap, named = diagnosis.verdict.gap, bool(diagnosis.verdict.effects)
    rows = []
    for stage, before in gap.before.items():
        after, floor, ceiling = (q.get(stage) for q in (gap.after, gap.floor, gap.ceiling))
        shown = after if named else None
        drawn = charts.ladder(before.value, *(q.value if q else None for q in (shown, floor, ceiling)))
        texts = [quantity(q.value, q.unit) if q else "–" for q in (before, shown, ceiling, floor)]
        rows.append((_place(stage), *texts, drawn))
    robot = diagnosis.nominal is not None
    noise = "repeatability, sensor noise and the tolerance of a good simulator" if robot else "the level of noise"
    text = (
        "The ceiling is the gap that remains after a flexible model without physics; no effect can do much better. "
        f"The floor is {noise}."
    )
    head = ("stage", "before", "after", "ceiling", "floor", "on one scale")
    caption = "Gap before and after the correction, RMS"
    parts = [
        el("p", text),
        legend("nominal", *(["patched"] if named else []), "ceiling", "floor"),
        table(head, rows, caption, numbers=(1, 2, 3, 4)),
    ]
    for each in diagnosis.unexplained:
        parts += [el("h3", each.stage), _depends(each.explained_share, each.depends_on, named)]
    return join(parts)


def _place(stage: str) -> str:
    return "tip, whole chain" if stage == "chain" else stage


def _depends(explained: float, on: tuple[tuple[str, float], ...], named: bool) -> Html:
    share = bar(explained, "patched", percent(explained))
    effects = "the named effects" if named else "known effects"
    text = el("p", f"Share of the explainable gap that {effects} explain: ", share)
    if not on:
        return text
    most = max(value for _, value in on) or 1.0
    rows = ((name, bar(value / most, "plain", number(value, 2))) for name, value in on)
    return join([text, table(("signal", "importance"), rows, "Signals that the remaining gap depends on")])
