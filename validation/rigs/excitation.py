"""Excitations of a rig: one signal over time, between -1 and 1, in the rig's own time scale."""

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from validation.rigs.laws import Array

Shape = Callable[[Array, float, float, np.random.Generator], Array]
HOLD_MIN_S = 0.25


def _steps(t: Array, pace_s: float, fastest_hz: float, random: np.random.Generator) -> Array:
    """Steps of several sizes, out and back."""
    hold = max(5 * pace_s, HOLD_MIN_S)
    levels: list[float] = [0.0]
    while len(levels) * hold <= t[-1] + hold:
        size = float(random.choice((0.25, 0.5, 1.0))) * float(random.choice((-1.0, 1.0)))
        levels += [size, float(random.choice((0.0, -size, size / 2)))]
    return np.asarray(np.asarray(levels)[(t / hold).astype(int)])


def _holds(t: Array, pace_s: float, fastest_hz: float, random: np.random.Generator) -> Array:
    """Random levels, held for random times."""
    ends, levels = [0.0], [0.0]
    while ends[-1] <= t[-1]:
        ends.append(ends[-1] + float(random.uniform(1.0, 6.0)) * max(pace_s, HOLD_MIN_S / 3))
        levels.append(float(random.uniform(-1.0, 1.0)))
    return np.asarray(levels)[np.searchsorted(ends, t, side="right") - 1]


def _sines(t: Array, pace_s: float, fastest_hz: float, random: np.random.Generator) -> Array:
    """A slow and a fast sine with small amplitude, then both with large amplitude, a quarter of the trial each."""
    slow, quick = (min(w / (2 * math.pi * pace_s), fastest_hz) for w in (0.35, 1.1))
    slow = max(slow, 1.5 / (t[-1] / 4))
    quarter = np.minimum((4 * t / t[-1]).astype(int), 3)
    hz = np.array([slow, quick, slow, max(quick, slow)])[quarter]
    size = np.array([0.35, 0.35, 0.9, 0.9])[quarter]
    return np.asarray(size * np.sin(2 * math.pi * np.cumsum(hz) * (t[1] - t[0])))


def _chirp(t: Array, pace_s: float, fastest_hz: float, random: np.random.Generator) -> Array:
    """A sine whose frequency grows exponentially."""
    end = min(2.5 / (2 * math.pi * pace_s), fastest_hz)
    begin = min(max(0.08 / (2 * math.pi * pace_s), 1.0 / t[-1]), end / 3)
    hz = begin * (end / begin) ** (t / t[-1])
    return np.asarray(0.8 * np.sin(2 * math.pi * np.cumsum(hz) * (t[1] - t[0])))


def _multisine(t: Array, pace_s: float, fastest_hz: float, random: np.random.Generator) -> Array:
    """Sum of eight sines with random phases."""
    end = min(2.0 / (2 * math.pi * pace_s), fastest_hz)
    hz = np.geomspace(min(max(0.08 / (2 * math.pi * pace_s), 1.0 / t[-1]), end / 3), end, 8)
    phase = random.uniform(0, 2 * math.pi, 8)
    total = np.sum(np.sin(2 * math.pi * hz[:, None] * t + phase[:, None]), axis=0)
    return np.asarray(0.95 * total / np.max(np.abs(total)) * np.minimum(t / 0.5, 1.0))


def _slow_sine(t: Array, pace_s: float, fastest_hz: float, random: np.random.Generator) -> Array:
    """A single slow sine."""
    hz = max(0.12 / (2 * math.pi * pace_s), 2.0 / t[-1])
    return np.asarray(0.8 * np.sin(2 * math.pi * hz * t))


def _plateau(t: Array, pace_s: float, fastest_hz: float, random: np.random.Generator) -> Array:
    """A constant level with a small multisine."""
    return np.asarray(0.8 + 0.015 * _multisine(t, pace_s, fastest_hz, random))


def _one_speed(t: Array, pace_s: float, fastest_hz: float, random: np.random.Generator) -> Array:
    """One direction at constant speed."""
    return np.asarray(2 * t / t[-1] - 1)


SHAPES: Final[dict[str, Shape]] = {
    "steps": _steps,
    "holds": _holds,
    "sines": _sines,
    "chirp": _chirp,
    "multisine": _multisine,
    "slow sine": _slow_sine,
    "plateau": _plateau,
    "one speed": _one_speed,
}


def signal(kind: str, t_s: Array, pace_s: float, random: np.random.Generator) -> Array:
    """Return an excitation of `SHAPES` at equally spaced times; its highest frequency is the sample rate over 12."""
    return SHAPES[kind](t_s, pace_s, 1 / (12 * (t_s[1] - t_s[0])), random)
