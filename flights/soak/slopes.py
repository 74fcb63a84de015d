"""Does a quantity grow? A straight line through its samples, and how sure its slope is."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np

BLOCKS = 8
WINDOWS = 64  # of what comes after the warm-up; each gives one number
_T95 = 2.365  # Student's t, 97.5 %, BLOCKS - 1 degrees of freedom
WARM_UP_SHARE, WARM_UP_MAX_H = 0.25, 0.25  # of a run; what fills caches is no leak

Statistic = Callable[[np.ndarray], float]
Verdict = Literal["flat", "grows", "too short to tell"]


class Slope(NamedTuple):
    """Growth an hour (or what else the time is counted in) with its 95 % interval, and what is allowed."""

    value: float
    low: float
    high: float
    allowed: float

    @property
    def verdict(self) -> Verdict:
        """Flat: at most what is allowed, surely. Grows: more, surely."""
        return "flat" if self.high <= self.allowed else "grows" if self.low > self.allowed else "too short to tell"


def slope(time: Sequence[float], values: Sequence[float], allowed: float, of: Statistic = np.median) -> Slope:
    """Of what comes after the warm-up.

    of: what stands for a window of time; the least, for what is taken and given back: a leak raises that too.
    Windows depend on their neighbours: blocks of them are left out one at a time, the same jackknife as
    `softarm.diagnosis.engine.jackknife`, for one line. Infinitely wide for too few samples.
    """
    t, y = np.asarray(time, float), np.asarray(values, float)
    warm = t - t[0] >= warm_up(float(t[-1] - t[0])) if len(t) else np.zeros(0, bool)
    t, y = t[warm], y[warm]
    if len(t) < 2 * BLOCKS:
        return Slope(math.nan, -math.inf, math.inf, allowed)
    parts = min(WINDOWS, len(t))
    t = np.array([part.mean() for part in np.array_split(t, parts)])
    y = np.array([of(part) for part in np.array_split(y, parts)])
    whole = _fit(t, y)
    block = np.arange(len(t)) * BLOCKS // len(t)
    moved = np.array([_fit(t[block != one], y[block != one]) for one in range(BLOCKS)]) - whole
    half = _T95 * math.sqrt((BLOCKS - 1) / BLOCKS * float(np.sum(moved**2)))
    return Slope(whole, whole - half, whole + half, allowed)


def warm_up(length: float) -> float:
    """How much of a run of this length does not count."""
    return min(WARM_UP_SHARE * length, WARM_UP_MAX_H)


def judge(slopes: Mapping[str, Slope], per: str) -> list[str]:
    """A sentence for each that is not flat. per: what time is counted in."""
    return [
        f"{name} {one.verdict}: {one.value:.3g} per {per} ({one.low:.3g} to {one.high:.3g}), allowed {one.allowed:g}"
        for name, one in slopes.items()
        if one.verdict != "flat"
    ]


def _fit(t: np.ndarray, y: np.ndarray) -> float:
    centred = t - t.mean()
    return float(centred @ y / (centred @ centred))
