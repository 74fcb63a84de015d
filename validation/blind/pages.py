"""Markdown tables of the wrong answers and of the detection limits."""

from collections.abc import Iterator, Mapping
from typing import Any

from validation.blind.imperfections import UNKNOWN, UNKNOWNS, ranges


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


def wrong_answers(methods: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    """Yield the lines of a table of the wrong answers of each method."""
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
