"""Lines, paths and texts of SVG drawings; the style sheet defines their colours."""

import math
from collections.abc import Iterable

from softarm.reporting.markup import Html, el


def path(x: Iterable[float], y: Iterable[float]) -> str:
    """Return points as the `d` attribute of a path; NaN or infinity interrupts the line."""
    parts, pen = [], "M"
    for a, b in zip(x, y, strict=True):
        if not (math.isfinite(a) and math.isfinite(b)):
            pen = "M"
            continue
        parts.append(f"{pen}{a:.1f} {b:.1f}")
        pen = "L"
    return "".join(parts)


def svg(width: float, height: float, text: str, *children: Html, kind: str = "chart") -> Html:
    """Return a drawing that scales with its container; `text` describes it for screen readers."""
    place = f"0 0 {width:.0f} {height:.0f}"
    return el("svg", el("title", text), *children, viewBox=place, role="img", class_=kind, aria_label=text)


def write(x: float, y: float, text: str, anchor: str = "start", kind: str = "") -> Html:
    """Return a text of a drawing."""
    return el("text", text, x=f"{x:.1f}", y=f"{y:.1f}", text_anchor=anchor, class_=kind or None)


def line(x1: float, y1: float, x2: float, y2: float, kind: str) -> Html:
    """Return a straight line of a drawing."""
    return el("line", x1=f"{x1:.1f}", y1=f"{y1:.1f}", x2=f"{x2:.1f}", y2=f"{y2:.1f}", class_=kind)
