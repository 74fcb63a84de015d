"""Sections that show the evidence: overlays, spectra and regimes, rivals, what is left. Result in, HTML out."""

from collections.abc import Callable, Sequence
from typing import TypeVar

from softarm.diagnosis.engine.result import Diagnosis, Regime, Rival, Spectrum
from softarm.diagnosis.report import overlays
from softarm.diagnosis.report.words import percents, unit_of
from softarm.pages import charts, plot
from softarm.pages.markup import Html, bar, el, join, legend, prose, table
from softarm.pages.numbers import number, percent, quantity
from softarm.schemas.verdict import Interval

Row = TypeVar("Row")
_AT_ONCE = 20  # rows of a table


def traces(diagnosis: Diagnosis) -> Html:
    """Measured, nominal and patched over time; drawn by the page's script from the data beneath."""
    if not diagnosis.overlays:
        return el("p", "This diagnosis holds no recordings to draw.", class_="none")
    shown = overlays.traces(diagnosis)
    kinds = max((list(one.curves) for one in shown), key=len)
    every = plot.every(shown)
    thin = f" To keep this page small, one of {every} samples is drawn." if every > 1 else ""
    told = (
        "Each stage is simulated alone, driven by what was measured before it, so that no stage answers for another. "
        f"The strip beneath is measured minus simulated; its grey band is the stage's floor.{thin}"
    )
    drawn = plot.canvas(overlays.CHOICES, kinds, "measured and simulated signals over time")
    return join([el("p", told), drawn])


def frequencies(diagnosis: Diagnosis) -> Html:
    """In which band the residual is, and in which part of the data."""
    drawn = [(s, drawing) for s in diagnosis.spectra if (drawing := _spectrum(s)) is not None]
    figures = [el("figure", el("figcaption", el("b", s.stage), f"  {s.unit}/√Hz"), drawing) for s, drawing in drawn]
    patched = any(s.patched is not None for s, _ in drawn)
    parts: list[Html] = []
    if figures:
        parts += [
            el("p", "Amplitude density of measured minus simulated, all trials and channels of a stage together."),
            legend(*(("nominal", "patched") if patched else ("nominal",)), "floor"),
            el("div", *figures, class_="multiples"),
        ]
    if diagnosis.regimes:
        stage = diagnosis.verdict.where.stage
        shown, rest = _split(diagnosis.regimes, lambda regime: regime.stage == stage)
        parts += [el("h3", "By regime"), _regimes(shown), *_folded("other stages", rest, _regimes)]
    return join(parts) if parts else el("p", "No spectra were computed.", class_="none")


def _spectrum(of: Spectrum) -> Html | None:
    curves = {"nominal": of.nominal} if of.patched is None else {"nominal": of.nominal, "patched": of.patched}
    text = f"Residual amplitude density of {of.stage} in {of.unit} per root hertz over frequency"
    return charts.spectrum(of.frequency_hz, curves, of.floor, text)


def _split(rows: Sequence[Row], first: Callable[[Row], bool]) -> tuple[list[Row], list[Row]]:
    """The rows to show and those to fold away: of a few all are shown, of many those of the blamed stage."""
    shown = [row for row in rows if first(row)]
    if len(rows) <= _AT_ONCE or not shown:
        return list(rows), []
    return shown, [row for row in rows if not first(row)]


def _folded(what: str, rows: Sequence[Row], draw: Callable[[Sequence[Row]], Html]) -> list[Html]:
    """What opens when it is asked for; nothing where there are no rows."""
    return [el("details", el("summary", f"{what}: {len(rows)} rows more"), draw(rows))] if rows else []


def _regimes(regimes: Sequence[Regime]) -> Html:
    """A regime a row; bars are relative to the largest of their stage."""
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
    caption = "Root mean square of the residual by regime; bars are relative to the largest of their stage"
    return table(head, rows, caption, numbers=(2,))


def contenders(diagnosis: Diagnosis) -> Html:
    """Every effect that was tried as the cause."""
    if not diagnosis.rivals:
        return el("p", "No effect was tried.", class_="none")
    forest = charts.Forest([r.conditional for r in diagnosis.rivals if r.conditional is not None])
    head = ("effect", "alone", join(["beside the named ones, percent", forest.axis()]), "fitted", "note")
    robot = diagnosis.nominal is not None
    beside = "of what the named effect adds" if robot else "of what is left without it"
    caption = (
        f"Effects that were tried as the cause; alone: share of the stage's gap; beside the others: share {beside}"
    )

    def drawn(rivals: Sequence[Rival]) -> Html:
        return el("div", table(head, [_rival(diagnosis, rival, forest) for rival in rivals], caption), class_="rivals")

    stage = diagnosis.verdict.where.stage
    shown, rest = _split(diagnosis.rivals, lambda rival: any(name.startswith(f"{stage}.") for name in rival.names))
    told = (
        "Alone, a wrong effect can pass for the right one. What counts is the second figure: what an effect adds "
        "beside the others, with its 95 % interval. An effect whose interval is clear of zero adds something."
    )
    return join([el("p", prose(told)), drawn(shown), *_folded("other stages", rest, drawn)])


def _rival(diagnosis: Diagnosis, rival: Rival, forest: charts.Forest) -> tuple[Html, ...]:
    name = join([el("code", name) for name in rival.names], " + ")
    fitted = [
        el(
            "span",
            f"{path.rpartition('.')[2]} {quantity(value, unit_of(diagnosis, path), 3)}",
            title=path,
            class_="fit",
        )
        for path, value in rival.parameters.items()
    ]
    note = el("span", prose(rival.note), class_="tag named" if rival.note == "named" else None)
    return name, bar(rival.alone, "plain", percent(rival.alone)), _added(rival.conditional, forest), join(fitted), note


def _added(of: Interval | None, forest: charts.Forest) -> Html:
    if of is None:
        return Html("–")
    return el("span", forest.row(of, percents(of)), el("span", percents(of), class_="num"), class_="forestcell")


def left(diagnosis: Diagnosis) -> Html:
    """What stays: stage by stage against floor and ceiling, and what the rest depends on."""
    gap, named = diagnosis.verdict.gap, bool(diagnosis.verdict.effects)
    rows = []
    for stage, before in gap.before.items():
        after, floor, ceiling = (q.get(stage) for q in (gap.after, gap.floor, gap.ceiling))
        shown = after if named else None
        drawn = charts.ladder(before.value, *(q.value if q else None for q in (shown, floor, ceiling)))
        texts = [quantity(q.value, q.unit) if q else "–" for q in (before, shown, ceiling, floor)]
        rows.append((_place(stage), *texts, drawn))
    robot = diagnosis.nominal is not None
    counts = "repeats, noise and what two honest simulators of one robot differ by" if robot else "what counts as none"
    told = (
        "The ceiling is what a flexible model with no physics in it leaves: nothing known or unknown could do much "
        f"better. The floor is {counts}."
    )
    head = ("stage", "before", "after", "ceiling", "floor", "on one scale")
    caption = "Root mean square of the gap, before and after"
    parts = [
        el("p", told),
        legend("nominal", *(["patched"] if named else []), "ceiling", "floor"),
        table(head, rows, caption, numbers=(1, 2, 3, 4)),
    ]
    for leftover in diagnosis.leftovers:
        parts += [el("h3", leftover.stage), _depends(leftover.explained_share, leftover.depends_on, named)]
    return join(parts)


def _place(stage: str) -> str:
    return "tip, whole chain" if stage == "chain" else stage


def _depends(explained: float, on: tuple[tuple[str, float], ...], named: bool) -> Html:
    share = bar(explained, "patched", percent(explained))
    who = "by the named effects" if named else "by known effects"
    text = el("p", f"Of what any model could explain here, explained {who}: ", share)
    if not on:
        return text
    most = max(value for _, value in on) or 1.0
    rows = ((name, bar(value / most, "plain", number(value, 2))) for name, value in on)
    return join([text, table(("what is left depends on", "importance"), rows, "Features of the residual that is left")])
