"""Markdown tables and reliability diagram of a score."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from softarm.reporting.colours import LIGHT
from validation.blind.imperfections import UNKNOWN, UNKNOWNS, ranges


def markdown(result: Mapping[str, Any]) -> str:
    """Return the tables of a score: one column for each method, and the wrong answers of each."""
    methods: Mapping[str, Mapping[str, Any]] = result["methods"]
    return "\n".join((*measures(methods), "", *_causes(methods), *_all_wrong(methods))) + "\n"


def detection(found: Mapping[str, Any]) -> str:
    """Return the table of detection limits, from the figures of `validation.detection`."""
    lines = ["| cause | drawn | found in 90 % from | share of the weakest drawn |", "|---|---|---|---|"]
    for row in found["causes"]:
        limit = "- | -" if row["share"] is None else f"{row['found']:.3g} | {row['share']:.2f}"
        lines.append(f"| {row['cause']} | {row['drawn']} | {limit} |")
    unknown = [(UNKNOWN + name, variant) for name, variants in UNKNOWNS.items() for variant in variants]
    lines += [f"| {name} | {ranges(variant)} | no effect of the registry | |" for name, variant in unknown]
    named = f"{found['healthy named']} of {found['healthy']} healthy robots got a name."
    return "\n".join([*lines, "", f"{found['draws']} robots for each row; {named}"]) + "\n"


def measures(methods: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    """Yield the lines of the table of measures, one row for each measure and one column for each method."""
    first = next(iter(methods.values()))
    yield f"| {first['cases']} cases | " + " | ".join(methods) + " |"
    yield "|---|" + "---|" * len(methods)
    for name in first["measures"]:
        yield f"| {name} | " + " | ".join(_share(method["measures"][name]) for method in methods.values()) + " |"
    for name in first["coverage"]:
        cells = (_share(method["coverage"][name]) for method in methods.values())
        what = "a size holds" if name == "size" else f"the shrink holds, {name}"
        yield f"| 95 % interval of {what} | " + " | ".join(cells) + " |"
    cells = (_number(method["calibration"]["ece"], ".3f") for method in methods.values())
    yield "| calibration error (ECE) | " + " | ".join(cells) + " |"
    for name in ("median", "worst"):
        cells = (_number(method[f"seconds_{name}"], ".0f") for method in methods.values())
        yield f"| processor seconds a case, {name} | " + " | ".join(cells) + " |"


def _causes(methods: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    yield "| cause, alone | " + " | ".join(f"right: {name}" for name in methods) + " |"
    yield "|---|" + "---|" * len(methods)
    for cause in next(iter(methods.values()))["by_cause"]:
        cells = (method["by_cause"][cause] for method in methods.values())
        yield f"| {cause} | " + " | ".join(f"{cell['hits']} of {cell['of']}" for cell in cells) + " |"


def _all_wrong(methods: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    for name, method in methods.items():
        yield from ("", f"Wrong answers of `{name}`:", "", "| case | truth | verdict | named (confidence) |")
        yield "|---|---|---|---|"
        for wrong in method["wrong"]:
            named = ", ".join(
                "/".join((e["name"], *e["equivalents"]))
                + ("" if e["confidence"] is None else f" ({e['confidence']:.2f})")
                for e in wrong["named"]
            )
            truth = " and ".join(wrong["causes"]) or "none"
            verdict = wrong["verdict"].replace("|", "/").replace("\n", " ")
            yield f"| {wrong['case']} | {truth} | {verdict} | {named or '-'} |"


def _share(cell: Mapping[str, Any]) -> str:
    if cell["share"] is None:
        return "-"
    return f"{cell['share']:.0%} ({cell['low']:.0%} .. {cell['high']:.0%}; {cell['hits']} of {cell['of']})"


def _number(value: float | None, how: str) -> str:
    return "-" if value is None else format(value, how)


def reliability(calibration: Mapping[str, Any], title: str, file: Path) -> None:
    """Write a PNG of the share of right names against confidence; raise OSError if it cannot be written."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.5, 4.5), layout="constrained")
    axes = figure.subplots()
    axes.plot((0, 1), (0, 1), color="0.6", lw=0.8)
    bins = [b for b in calibration["bins"] if b["of"]]
    x, y = [b["confidence"] for b in bins], [b["share"] for b in bins]
    around = [[b["share"] - b["low"] for b in bins], [b["high"] - b["share"] for b in bins]]
    axes.errorbar(x, y, around, fmt="o", color=LIGHT["accent"], capsize=3)
    for b in bins:
        axes.annotate(str(b["of"]), (b["confidence"], b["share"]), textcoords="offset points", xytext=(6, -10))
    axes.set(xlim=(0, 1), ylim=(0, 1), xlabel="confidence", ylabel="share right (95 %)")
    ece = _number(calibration["ece"], ".3f")
    axes.set_title(f"{title}: {calibration['named']} names, ECE {ece}")
    FigureCanvasAgg(figure).print_png(str(file))
