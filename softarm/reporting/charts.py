"""Small SVG charts: spectra, intervals, signals, bars and a map; the style sheet defines their colours."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from softarm.reporting.markup import Html, el
from softarm.reporting.numbers import number, percent


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


Array = NDArray[np.float64]

_SPECTRUM_BINS = 160
_WIDTH, _HEIGHT = 460.0, 260.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 62.0, 10.0, 10.0, 40.0
_RADIUS = 9.0  # of a place on a map


class Span(Protocol):
    """A value with a lower and an upper bound."""

    @property
    def value(self) -> float: ...  # noqa: D102
    @property
    def low(self) -> float: ...  # noqa: D102
    @property
    def high(self) -> float: ...  # noqa: D102


def decades(low: float, high: float) -> list[float]:
    """Return the powers of ten within a range, and multiples of them if there are fewer than three."""
    exponents = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for steps in ((1.0,), (1.0, 3.0), (1.0, 2.0, 5.0)):
        ticks = [s * 10.0**e for e in exponents for s in steps if low <= s * 10.0**e <= high]
        if len(ticks) >= 3:
            break
    return ticks


def thinned(frequency_hz: Array, density: Array) -> tuple[Array, Array]:
    """Return the root mean squares over equal intervals of log frequency, few enough for a chart."""
    good = (frequency_hz > 0) & np.isfinite(density)
    f, d = frequency_hz[good], density[good]
    if len(f) <= _SPECTRUM_BINS:
        return f, d
    edges = np.geomspace(f[0], f[-1] * (1 + 1e-9), _SPECTRUM_BINS + 1)
    place = np.searchsorted(edges, f, side="right")
    groups, index = np.unique(place, return_inverse=True)
    count = np.bincount(index, minlength=len(groups))
    return np.bincount(index, f) / count, np.sqrt(np.bincount(index, d * d) / count)


def spectrum(frequency_hz: Array, curves: Mapping[str, Array], floor: float, text: str) -> Html | None:
    """Return a chart of densities by frequency, both axes logarithmic, or None without positive densities.

    Args:
        frequency_hz: Frequencies of all curves.
        curves: Densities by name; the name also selects the colour.
        floor: Level to mark, in the curves' unit; zero, negative and infinite levels are not marked.
        text: Description of the chart; the curves' names are appended.
    """
    thin = {name: thinned(frequency_hz, density) for name, density in curves.items()}
    drawn = {name: (f[d > 0], d[d > 0]) for name, (f, d) in thin.items() if (d > 0).any()}
    if not drawn:
        return None
    frequencies = np.concatenate([f for f, _ in drawn.values()])
    level = [floor] if floor > 0 and math.isfinite(floor) else []
    densities = np.concatenate([*(d for _, d in drawn.values()), level])
    f_low, f_high = float(frequencies.min()), float(frequencies.max())
    f_high = f_high if f_high > f_low else f_low * 2
    d_low, d_high = max(densities.min(), densities.max() * 1e-5) / 1.5, densities.max() * 1.5
    right, bottom = _WIDTH - _RIGHT, _HEIGHT - _BOTTOM

    def x(f: Array | float) -> Array:
        share = np.log(np.asarray(f) / f_low) / math.log(f_high / f_low)
        return np.asarray(_LEFT + share * (right - _LEFT))

    def y(d: Array | float) -> Array:
        share = np.log(np.maximum(d, d_low) / d_low) / math.log(d_high / d_low)
        return np.asarray(bottom - share * (bottom - _TOP))

    parts = []
    for tick in decades(f_low, f_high):
        at = float(x(tick))
        parts += [line(at, _TOP, at, bottom, "grid"), write(at, _HEIGHT - 24, number(tick, 1), "middle")]
    for tick in decades(d_low, d_high):
        at = float(y(tick))
        parts += [line(_LEFT, at, right, at, "grid"), write(_LEFT - 6, at + 4, _power(tick), "end")]
    parts += [line(_LEFT, float(y(at)), right, float(y(at)), "floor") for at in level]
    for name, (f, d) in drawn.items():
        parts.append(el("path", d=path(x(f).tolist(), y(d).tolist()), class_=f"curve {name}"))
    parts.append(write((_LEFT + right) / 2, _HEIGHT - 6, "frequency (Hz)", "middle", "axis"))
    return svg(_WIDTH, _HEIGHT, f"{text}: {', '.join(drawn)}", *parts)


def _power(tick: float) -> str:
    return number(tick, 1) if 1e-3 <= tick < 1e5 else f"{tick:.0e}".replace("e-0", "e-").replace("e+0", "e")


class Forest:
    """Intervals of shares on a common axis, one row each."""

    _W, _H = 240.0, 22.0

    def __init__(self, intervals: Sequence[Span]) -> None:
        """Create an axis that contains zero and every interval, cut at -50 % and 100 %."""
        low = min((max(i.low, -0.5) for i in intervals), default=0.0)
        high = max((min(i.high, 1.0) for i in intervals), default=1.0)
        self._low, self._high = min(low, 0.0) - 0.02, max(high, 0.1) + 0.02

    def _x(self, share: float) -> float:
        inside = (min(max(share, self._low), self._high) - self._low) / (self._high - self._low)
        return 8 + inside * (self._W - 16)

    def row(self, interval: Span, text: str) -> Html:
        """Return the row of one interval: a point with its whisker."""
        middle = self._H / 2
        low, high = self._x(interval.low), self._x(interval.high)
        ends = (line(e, middle - 4, e, middle + 4, "whisker") for e in (low, high))
        clear = " clear" if interval.low > 0 else ""
        dot = el("circle", cx=f"{self._x(interval.value):.1f}", cy=middle, r=4.5, class_=f"dot{clear}")
        zero = line(self._x(0), 0, self._x(0), self._H, "zero")
        return svg(self._W, self._H, text, zero, line(low, middle, high, middle, "whisker"), *ends, dot, kind="forest")

    def axis(self) -> Html:
        """Return the scale above the rows."""
        span = self._high - self._low
        step = next((s for s in (0.05, 0.1, 0.2, 0.25, 0.5) if span / s <= 5), 1.0)
        ticks = [k * step for k in range(math.ceil(self._low / step), math.floor(self._high / step) + 1)]
        marks = [write(self._x(t), 14, f"{round(100 * t)}", "middle") for t in ticks]
        return svg(self._W, 18, "share of the gap in percent", *marks, kind="forest")


def lanes(t: Array, curves: Mapping[str, Array], text: str, unit: str = "s") -> Html:
    """Return a chart of signals over time (in `unit`), one below the other, each with a scale that contains zero."""
    height, parts = 86.0, []
    x = (_LEFT + t / t[-1] * (_WIDTH - _LEFT - _RIGHT)).tolist()
    for i, (name, values) in enumerate(curves.items()):
        low, high = float(min(values.min(), 0.0)), float(values.max())
        top = 18 + i * height
        y = (top + (high - values) / ((high - low) or 1.0) * (height - 30)).tolist()
        parts += [
            write(_LEFT, top - 6, name),
            write(_LEFT - 6, top + 8, number(high, 2), "end"),
            write(_LEFT - 6, top + height - 28, number(low, 2), "end"),
            el("path", d=path(x, y), class_="curve measured"),
        ]
    bottom = 18 + len(curves) * height
    parts += [
        write(_LEFT, bottom, f"0 {unit}"),
        write(_WIDTH - _RIGHT, bottom, f"{number(float(t[-1]), 2)} {unit}", "end"),
    ]
    return svg(_WIDTH, bottom + 8, text, *parts)


def ladder(before: float, after: float | None, floor: float | None, ceiling: float | None) -> Html:
    """Return the gap before and after as bars, with marks at floor and ceiling; all values have one unit."""
    width, most = 240.0, max(before, after or 0.0, floor or 0.0, ceiling or 0.0) or 1.0
    parts = [el("rect", x=0, y=3, width=f"{before / most * width:.1f}", height=8, class_="fill nominal")]
    if after is not None:
        parts.append(el("rect", x=0, y=13, width=f"{after / most * width:.1f}", height=8, class_="fill patched"))
    for value, kind in ((ceiling, "ceiling"), (floor, "floor")):
        if value is not None:
            at = min(max(value / most * width, 1.0), width - 1.0)
            parts.append(line(at, 0, at, 24, kind))
    text = "before" if after is None or before <= 0 else f"after is {percent(after / before)} of before"
    return svg(width, 24, text, *parts, kind="ladder")


def disc_map(
    y_m: Sequence[float], z_m: Sequence[float], shares: Sequence[float], title: str, notes: Sequence[str] = ()
) -> Html:
    """Return a map of places with a mark of each share, as in `map_legend`.

    Args:
        y_m: y of the places, m, [N].
        z_m: z of the places, m, [N].
        shares: Share of each place, 0 .. 1, [N].
        title: Name of the map.
        notes: Text of each place when the pointer is on it, [N]; by default its share.
    """
    scale, left, top = 560.0, 46.0, 14.0
    width, height = left + scale * (max(y_m) - min(y_m)) + 20, top + scale * (max(z_m) - min(z_m)) + 34

    def x_at(y: float) -> float:
        return left + scale * (y - min(y_m))

    def y_at(z: float) -> float:
        return top + scale * (max(z_m) - z)

    parts: list[Html] = []
    for y, z, share, note in zip(y_m, z_m, shares, notes or [percent(share) for share in shares], strict=True):
        label = el("title", f"y {y:.2f}, z {z:.2f} m: {note}")
        parts.append(el("g", label, *_mark(x_at(y), y_at(z), share)))
    parts += [write(left - 16, y_at(z) + 4, f"{z:.2f}", "end") for z in sorted(set(z_m))]
    parts += [write(x_at(y), height - 8, f"{y:.2f}", "middle") for y in sorted(set(y_m))[::2]]
    caption = el("figcaption", el("b", title), " (z over y, m)")
    return el("figure", caption, svg(width, height, f"{title}: targets reached", *parts))


def map_legend(all_of_them: str, some: str, none: str) -> Html:
    """Return the legend of the marks of `disc_map`: full share, part of it, zero."""
    marks = ((1.0, all_of_them), (0.4, some), (0.0, none))
    drawn = (
        (el("svg", *_mark(11, 11, share), viewBox="0 0 22 22", width=22, height=22), text) for share, text in marks
    )
    return el("p", *(el("span", mark, text, class_="entry") for mark, text in drawn), class_="legend")


def _mark(x: float, y: float, share: float) -> list[Html]:
    """Return a full disc, a disc whose area is the share, in a ring, or a cross for zero."""
    if share <= 0:
        # Without a fill, only the strokes would react to the pointer.
        ground = el("circle", cx=f"{x:.1f}", cy=f"{y:.1f}", r=_RADIUS, class_="ground")
        arms = path((x - 6, x + 6, math.nan, x - 6, x + 6), (y - 6, y + 6, math.nan, y + 6, y - 6))
        return [ground, el("path", d=arms, class_="missed")]
    at = {"cx": f"{x:.1f}", "cy": f"{y:.1f}"}
    radius = _RADIUS if share >= 1 else (_RADIUS - 2.5) * math.sqrt(share)
    ink = el("circle", **at, r=f"{radius:.1f}", class_="ink")
    return [el("circle", **at, r=_RADIUS, class_="ring"), ink]
