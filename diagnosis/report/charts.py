"""Small drawings: spectra, intervals, a commanded signal. Values in, SVG out; colours are the style sheet's."""

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.gap.result import Spectrum
from softarm.diagnosis.report.markup import Html, el, join
from softarm.diagnosis.report.words import number, percent
from softarm.schemas.excitation import Excitation
from softarm.schemas.verdict import Interval

Array = NDArray[np.float64]

_SPECTRUM_BINS = 160
_WIDTH, _HEIGHT = 460.0, 260.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 62.0, 10.0, 10.0, 40.0


def path(x: Iterable[float], y: Iterable[float]) -> str:
    """Points as the `d` of a path; a point that is not finite breaks it."""
    parts, pen = [], "M"
    for a, b in zip(x, y, strict=True):
        if not (math.isfinite(a) and math.isfinite(b)):
            pen = "M"
            continue
        parts.append(f"{pen}{a:.1f} {b:.1f}")
        pen = "L"
    return "".join(parts)


def svg(width: float, height: float, text: str, *children: Html, kind: str = "chart") -> Html:
    """A drawing that scales with its place; `text` says what it shows to who cannot see it."""
    return el(
        "svg", el("title", text), *children, viewBox=f"0 0 {width:.0f} {height:.0f}", role="img", class_=kind,
        aria_label=text,
    )  # fmt: skip


def write(x: float, y: float, text: str, anchor: str = "start", kind: str = "") -> Html:
    """Text in a drawing."""
    return el("text", text, x=f"{x:.1f}", y=f"{y:.1f}", text_anchor=anchor, class_=kind or None)


def line(x1: float, y1: float, x2: float, y2: float, kind: str) -> Html:
    """A straight line in a drawing."""
    return el("line", x1=f"{x1:.1f}", y1=f"{y1:.1f}", x2=f"{x2:.1f}", y2=f"{y2:.1f}", class_=kind)


def decades(low: float, high: float) -> list[float]:
    """Powers of ten within a range, and twos and fives where there are few."""
    exponents = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for steps in ((1.0,), (1.0, 3.0), (1.0, 2.0, 5.0)):
        ticks = [s * 10.0**e for e in exponents for s in steps if low <= s * 10.0**e <= high]
        if len(ticks) >= 3:
            break
    return ticks


def thinned(frequency_hz: Array, density: Array, bins: int = _SPECTRUM_BINS) -> tuple[Array, Array]:
    """Root mean squares over equal stretches of log frequency: what a line of this width can show."""
    good = (frequency_hz > 0) & np.isfinite(density)
    f, d = frequency_hz[good], density[good]
    if len(f) <= bins:
        return f, d
    edges = np.geomspace(f[0], f[-1] * (1 + 1e-9), bins + 1)
    place = np.searchsorted(edges, f, side="right")
    groups, index = np.unique(place, return_inverse=True)
    count = np.bincount(index, minlength=len(groups))
    return np.bincount(index, f) / count, np.sqrt(np.bincount(index, d * d) / count)


def spectrum(of: Spectrum) -> Html | None:
    """Residuals by frequency, both axes logarithmic; None where there is nothing to draw."""
    given = (("nominal", of.nominal), ("patched", of.patched))
    curves = {kind: thinned(of.frequency_hz, density) for kind, density in given if density is not None}
    curves = {kind: (f[d > 0], d[d > 0]) for kind, (f, d) in curves.items() if (d > 0).any()}
    if not curves:
        return None
    f_low, f_high = (pick([f.min() if pick is min else f.max() for f, _ in curves.values()]) for pick in (min, max))
    floor = of.floor if of.floor > 0 and math.isfinite(of.floor) else None
    values = np.concatenate([d for _, d in curves.values()] + ([np.array([floor])] if floor else []))
    d_low, d_high = max(values.min(), values.max() * 1e-5) / 1.5, values.max() * 1.5
    f_high = f_high if f_high > f_low else f_low * 2

    def x(f: Array | float) -> Array:
        share = np.log(np.asarray(f) / f_low) / math.log(f_high / f_low)
        return np.asarray(_LEFT + share * (_WIDTH - _LEFT - _RIGHT))

    def y(d: Array | float) -> Array:
        share = np.log(np.maximum(d, d_low) / d_low) / math.log(d_high / d_low)
        return np.asarray(_HEIGHT - _BOTTOM - share * (_HEIGHT - _TOP - _BOTTOM))

    parts = []
    for tick in decades(f_low, f_high):
        at = float(x(tick))
        parts += [line(at, _TOP, at, _HEIGHT - _BOTTOM, "grid"), write(at, _HEIGHT - 24, number(tick, 1), "middle")]
    for tick in decades(d_low, d_high):
        at = float(y(tick))
        parts += [line(_LEFT, at, _WIDTH - _RIGHT, at, "grid"), write(_LEFT - 6, at + 4, _power(tick), "end")]
    if floor:
        parts.append(line(_LEFT, float(y(floor)), _WIDTH - _RIGHT, float(y(floor)), "floor"))
    for kind, (f, d) in curves.items():
        parts.append(el("path", d=path(x(f).tolist(), y(d).tolist()), class_=f"curve {kind}"))
    parts.append(write((_LEFT + _WIDTH - _RIGHT) / 2, _HEIGHT - 6, "frequency (Hz)", "middle", "axis"))
    text = f"Residual amplitude density of {of.stage} in {of.unit} per root hertz over frequency: {', '.join(curves)}"
    return svg(_WIDTH, _HEIGHT, text, *parts)


def _power(tick: float) -> str:
    return number(tick, 1) if 1e-3 <= tick < 1e5 else f"{tick:.0e}".replace("e-0", "e-").replace("e+0", "e")


class Forest:
    """Intervals of shares on one axis, a row each."""

    _W, _H = 240.0, 22.0

    def __init__(self, intervals: Sequence[Interval]) -> None:
        """The axis holds zero and every interval; what is far outside -50 % .. 100 % is cut."""
        low = min((max(i.low, -0.5) for i in intervals), default=0.0)
        high = max((min(i.high, 1.0) for i in intervals), default=1.0)
        self._low, self._high = min(low, 0.0) - 0.02, max(high, 0.1) + 0.02

    def _x(self, share: float) -> float:
        inside = (min(max(share, self._low), self._high) - self._low) / (self._high - self._low)
        return 8 + inside * (self._W - 16)

    def row(self, of: Interval, text: str) -> Html:
        """A point with its whisker."""
        middle = self._H / 2
        low, high = self._x(of.low), self._x(of.high)
        ends = (line(e, middle - 4, e, middle + 4, "whisker") for e in (low, high))
        clear = " clear" if of.low > 0 else ""
        dot = el("circle", cx=f"{self._x(of.value):.1f}", cy=middle, r=4.5, class_=f"dot{clear}")
        zero = line(self._x(0), 0, self._x(0), self._H, "zero")
        return svg(self._W, self._H, text, zero, line(low, middle, high, middle, "whisker"), *ends, dot, kind="forest")

    def axis(self) -> Html:
        """The scale above the rows."""
        span = self._high - self._low
        step = next((s for s in (0.05, 0.1, 0.2, 0.25, 0.5) if span / s <= 5), 1.0)
        ticks = [k * step for k in range(math.ceil(self._low / step), math.floor(self._high / step) + 1)]
        marks = [write(self._x(t), 14, f"{round(100 * t)}", "middle") for t in ticks]
        return svg(self._W, 18, "share of the gap in percent", *marks, kind="forest")


def excitation(of: Excitation, samples: int = 600) -> Html:
    """What an excitation commands over time: pressure, and the cart's velocity where it moves."""
    t = np.linspace(0.0, of.duration_s, samples)
    velocity, pressure = np.array([of.at(float(s)) for s in t]).T
    lanes = [("pressure (kPa)", pressure)] if of.pressure_kpa else []
    lanes += [("cart (m/s)", velocity)] if of.moves_rail else []
    height, parts = 86.0, []
    x = (_LEFT + t / of.duration_s * (_WIDTH - _LEFT - _RIGHT)).tolist()
    for i, (name, values) in enumerate(lanes):
        low, high = float(min(values.min(), 0.0)), float(values.max())
        top = 18 + i * height
        y = (top + (high - values) / ((high - low) or 1.0) * (height - 30)).tolist()
        parts += [
            write(_LEFT, top - 6, name),
            write(_LEFT - 6, top + 8, number(high, 2), "end"),
            write(_LEFT - 6, top + height - 28, number(low, 2), "end"),
            el("path", d=path(x, y), class_="curve measured"),
        ]
    bottom = 18 + len(lanes) * height
    parts += [write(_LEFT, bottom, "0 s"), write(_WIDTH - _RIGHT, bottom, f"{of.duration_s:.0f} s", "end")]
    return svg(_WIDTH, bottom + 8, f"Commands of the excitation {of.name}: {of.description}", join(parts))


def ladder(before: float, after: float | None, floor: float | None, ceiling: float | None) -> Html:
    """Gap before and after as bars, with marks where floor and ceiling are; root mean squares of one unit."""
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
