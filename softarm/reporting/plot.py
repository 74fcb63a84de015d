"""Charts of recordings, which plot.js draws with uPlot: 16 bits per sample, stamps as start and step."""

import base64
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from softarm.reporting.markup import Html, el, join, legend

Array = NDArray[np.float64]

# Samples of a page over all its curves, about 10 MB. Larger recordings show every k-th sample; the page must state it.
BUDGET = 3_000_000
# The next level after the last one is NaN.
_STEPS = 65534
_UNIFORM_S = 1e-6


class Traces(NamedTuple):
    """Curves of one signal over time; the lower strip shows the first curve minus each other one."""

    chosen: tuple[str, ...]  # one entry of each choice; the last one names the signal
    note: str  # additional text
    unit: str
    t_s: Array
    curves: Mapping[str, Array]  # values by name, NaN if missing; the name also selects the colour
    band: float = 0.0  # smaller differences are within the measurement noise


def every(items: Sequence[Traces]) -> int:
    """Return the number of samples for each sample on the page."""
    return max(1, math.ceil(sum(len(item.t_s) * len(item.curves) for item in items) / BUDGET))


def packed(
    choices: Sequence[str], items: Sequence[Traces], first: int = 0, view: tuple[float, float] | None = None
) -> dict[str, object]:
    """Return the data for plot.js; `first` is the item shown first, `view` the time range (s) or None for all."""
    step = every(items)
    shown = {} if view is None else {"view": list(view)}
    return {"choices": list(choices), "first": first, **shown, "items": [_item(item, step) for item in items]}


def charts(choices: Sequence[str], kinds: Sequence[str], text: str) -> Html:
    """Return the place and controls of plot.js; `kinds` names the curves, `text` describes it for screen readers."""
    picks = (el("label", name, " ", el("select", id=f"pick-{name}", disabled="")) for name in choices)
    keys = (("−", "out", "zoom out"), ("+", "in", "zoom in"), ("‹", "left", "earlier"), ("›", "right", "later"))
    buttons = [el("button", text, type="button", data_do=do, aria_label=name) for text, do, name in keys]
    buttons.append(el("button", "whole trial", type="button", data_do="reset"))
    hint = "Drag to zoom. Drag with Shift to move. Double-click for the whole trial. Keyboard: arrows, +, − and 0."
    return join(
        [
            el("div", *picks, class_="picks"),
            legend(*kinds),
            el("div", id="traces", class_="plots", tabindex="0", role="img", aria_label=text),
            el("p", id="readout", class_="readout"),
            el("p", *buttons, class_="buttons"),
            el("p", hint, class_="hint"),
            el("noscript", el("p", "The plot needs JavaScript. Enable scripts for this page in the browser.")),
        ]
    )


def _item(item: Traces, step: int) -> dict[str, object]:
    return {
        "chosen": list(item.chosen),
        "note": item.note,
        "unit": "" if item.unit in ("-", "1") else item.unit,
        "band": item.band,
        "t": _stamps(item.t_s[::step]),
        "curves": {name: packed_levels(values[::step]) for name, values in item.curves.items()},
    }


def _stamps(t_s: Array) -> dict[str, object]:
    """Return start, step and count of uniform stamps, or microseconds since the start for other stamps."""
    n = len(t_s)
    start, step = (float(t_s[0]) if n else 0.0), (float(t_s[-1] - t_s[0]) / (n - 1) if n > 1 else 0.0)
    about: dict[str, object] = {"n": n, "start": round(start, 6)}
    if n < 2 or np.abs(t_s - (start + step * np.arange(n))).max() < _UNIFORM_S:
        return about | {"step": step}
    return about | {"us": _text(np.round((t_s - start) * 1e6).astype("<u4"))}


def packed_levels(values: Array) -> dict[str, object]:
    """Return values as 16-bit levels between their extremes; NaN and infinity are the last level."""
    seen = np.isfinite(values)
    low, high = (float(values[seen].min()), float(values[seen].max())) if seen.any() else (0.0, 0.0)
    scale = _STEPS / (high - low) if high > low else 0.0
    levels = np.full(len(values), _STEPS + 1, dtype="<u2")
    levels[seen] = np.round((values[seen] - low) * scale).astype("<u2")
    return {"low": low, "high": high, "levels": _text(levels)}


def packed_integers(values: NDArray[np.integer]) -> str:
    """Return whole numbers from 0 to 2^32 - 1 as text, four bytes each."""
    return _text(values.astype("<u4"))


def _text(values: NDArray[np.unsignedinteger]) -> str:
    return base64.b64encode(values.tobytes()).decode("ascii")
