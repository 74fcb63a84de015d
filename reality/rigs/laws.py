"""Pieces of machines, many lanes at a time: dry friction, play, hysteresis, an orifice, a queue."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]

_TINY = 1e-12
CRITICAL_RATIO = (2 / 2.4) ** 3.5  # downstream over upstream pressure below which air chokes (1.4: diatomic)
_SETTLING = 0.05  # of the level
_STIFFEST = 0.3  # of what a step can still follow: bristle frequency times step


class Bristles:
    """Dry friction of bristles that bend and slip (LuGre: Canudas de Wit et al., 1995), another level each way.

    Bristles relax exactly over a step, so any speed is stable. `up` and `down` are the levels (N, N m, m/s^2 ...)
    while moving with and against the coordinate; `stiction` is what breaking loose takes, in levels, and `stribeck`
    the speed by which that is forgotten.
    """

    def __init__(
        self,
        up: Array,
        down: Array,
        inertia: Array | float,
        give: Array | float,
        dt_s: float,
        stiction: Array | float = 1.0,
        stribeck: Array | float = 1.0,
    ) -> None:
        """give: way after which the level is reached, if a step can follow so stiff a bristle on such an inertia."""
        self.up, self.down = np.maximum(up, 0.0), np.maximum(down, 0.0)
        self._more, self._stribeck, self._dt_s = np.asarray(stiction) - 1.0, np.asarray(stribeck), dt_s
        level = np.maximum(np.maximum(self.up, self.down), _TINY)
        stiffest = np.asarray(inertia) * (_STIFFEST / dt_s) ** 2
        self._stiffness: Array = np.minimum(level / np.asarray(give), stiffest)
        self._damping: Array = 0.7 * np.sqrt(self._stiffness * np.asarray(inertia)) * (level > 2 * _TINY)
        self.bend: Array = np.zeros_like(level)
        self.any = bool(np.any(level > 2 * _TINY))

    def force(self, v: Array) -> Array:
        """What they hold against a motion at speed v; a step passes."""
        level = np.maximum(np.where(v > 0, self.up, self.down), _TINY)
        if np.any(self._more):
            level = level * (1 + self._more * np.exp(-((v / self._stribeck) ** 2)))
        rest = np.sign(v) * level / self._stiffness
        kept = np.exp(-np.abs(v) * self._stiffness / level * self._dt_s)
        bent = rest + (self.bend - rest) * kept
        rate = (bent - self.bend) / self._dt_s
        self.bend = bent
        # A stuck body settles; what damps it must not be felt beyond that, as it would be where bristles turn over.
        settling = np.clip(self._damping * rate, -_SETTLING * level, _SETTLING * level)
        return np.asarray(self._stiffness * bent + settling)


class Play:
    """What is driven through a gap: it moves when the gap is shut."""

    def __init__(self, gap: Array, start: Array) -> None:
        self._half, self.at = 0.5 * np.asarray(gap), np.array(start, dtype=float)

    def step(self, driver: Array) -> Array:
        """Where it stands when its driver stands there."""
        self.at = np.minimum(np.maximum(self.at, driver - self._half), driver + self._half)
        return self.at


class Loops:
    """Rate-independent hysteresis: a few plays of growing width side by side (Prandtl and Ishlinskii)."""

    SHARES = (0.20, 0.16, 0.12)
    WIDTHS = (0.4, 1.0, 1.8)  # of `width`

    def __init__(self, width: Array, start: Array) -> None:
        self._plays = [Play(w * np.asarray(width), start) for w in self.WIDTHS]

    def step(self, driver: Array) -> Array:
        """What comes out when that goes in."""
        out = (1 - sum(self.SHARES)) * driver
        for share, play in zip(self.SHARES, self._plays, strict=True):
            out = out + share * play.step(driver)
        return np.asarray(out)


def orifice(upstream: Array, downstream: Array) -> Array:
    """Flow of air through a hole, in upstream pressures (same unit, absolute); 0.685 when choked, 0 back upstream.

    Isentropic flow, heat ratio 1.4 (ISO 6358 rounds it by an ellipse).
    """
    ratio = np.clip(downstream / np.maximum(upstream, _TINY), CRITICAL_RATIO, 1.0)
    return np.asarray(upstream * np.sqrt(7.0 * np.maximum(ratio ** (2 / 1.4) - ratio ** (2.4 / 1.4), 0.0)))


def arrivals(sent_s: Array, delay_s: float, jitter_s: float, random: np.random.Generator) -> Array:
    """When each command of a queue is heard: in order, so a late one holds up the next."""
    late = random.exponential(jitter_s, len(sent_s)) if jitter_s > 0 else 0.0
    return np.maximum.accumulate(sent_s + delay_s + late)


def heard(t_s: Array, arrived_s: Array, values: Array) -> Array:
    """The newest value that has arrived at each time; the first one before that."""
    return np.asarray(values[np.maximum(np.searchsorted(arrived_s, t_s, side="right") - 1, 0)])


def sheared(value: Array, width: Array) -> Array:
    """What is left of a value beyond a dead zone of so much either way."""
    return np.asarray(value - np.minimum(np.maximum(value, -width), width))


def coloured(count: int, step_s: float, sigma: float, corner_hz: float, random: np.random.Generator) -> Array:
    """Noise whose power falls above a corner: a first-order autoregression."""
    kept = math.exp(-2 * math.pi * corner_hz * step_s)
    white = random.normal(0.0, sigma * math.sqrt(1 - kept * kept), count)
    out, last = np.empty(count), random.normal(0.0, sigma)
    for i in range(count):
        last = kept * last + white[i]
        out[i] = last
    return out


def stacked(lanes: Sequence[float]) -> Array:
    """A number a lane."""
    return np.asarray(lanes, dtype=float)
