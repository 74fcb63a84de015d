"""Laws of machine elements for many lanes at once: dry friction, play, hysteresis, orifice, queue."""

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.floating[Any]]

GRAVITY_M_S2 = 9.81
# Time constant of drift and wear.
CHANGE_S = 60.0
_TINY = 1e-12
# Ratio of downstream to upstream pressure below which the flow of air is choked (heat ratio 1.4).
CRITICAL_RATIO = (2 / 2.4) ** 3.5
# Largest damping force as a share of the friction level.
_SETTLING = 0.05
# Largest product of bristle frequency and step.
_STIFFEST = 0.3


class Bristles:
    """Dry friction of bristles that bend and slip (LuGre: Canudas de Wit et al., 1995), with a level per direction.

    The bristles relax exactly over a step, so every speed is stable.
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
        """Create the friction of many lanes.

        Args:
            up: Level while moving in positive direction (N, N m, m/s^2 ...).
            down: Level while moving in negative direction.
            inertia: Inertia that the friction acts on; with the step it limits the bristles' stiffness.
            give: Displacement after which the level is reached.
            stiction: Break-away force as a multiple of the level.
            stribeck: Speed at which the force falls from stiction to the level.
        """
        self.up, self.down = np.maximum(up, 0.0), np.maximum(down, 0.0)
        self._more, self._stribeck, self._dt_s = np.asarray(stiction) - 1.0, np.asarray(stribeck), dt_s
        level = np.maximum(np.maximum(self.up, self.down), _TINY)
        stiffest = np.asarray(inertia) * (_STIFFEST / dt_s) ** 2
        self._stiffness: Array = np.minimum(level / np.asarray(give), stiffest)
        self._damping: Array = 0.7 * np.sqrt(self._stiffness * np.asarray(inertia)) * (level > 2 * _TINY)
        self._sticks = bool(np.any(self._more))
        self.bend: Array = np.zeros_like(level)
        self.any = bool(np.any(level > 2 * _TINY))

    def force(self, v: Array) -> Array:
        """Advance by one step at a speed and return the friction force."""
        level = np.maximum(np.where(v > 0, self.up, self.down), _TINY)
        if self._sticks:
            level = level * (1 + self._more * np.exp(-((v / self._stribeck) ** 2)))
        rest = np.sign(v) * level / self._stiffness
        kept = np.exp(-np.abs(v) * self._stiffness / level * self._dt_s)
        bent = rest + (self.bend - rest) * kept
        rate = (bent - self.bend) / self._dt_s
        self.bend = bent
        # Damping settles a stuck body. It is limited because it must not add to the friction at a reversal.
        most = _SETTLING * level
        settling = np.minimum(np.maximum(self._damping * rate, -most), most)  # half the time of np.clip
        return np.asarray(self._stiffness * bent + settling)


class Play:
    """Backlash: the output moves only while the gap is closed."""

    def __init__(self, gap: Array, start: Array) -> None:
        self._half, self.at = 0.5 * np.asarray(gap), np.array(start, dtype=float)

    def step(self, driver: Array) -> Array:
        """Return the output position for a new position of the driver."""
        self.at = np.minimum(np.maximum(self.at, driver - self._half), driver + self._half)
        return self.at


class Loops:
    """Rate-independent hysteresis: parallel play operators of growing width (Prandtl and Ishlinskii)."""

    SHARES = (0.20, 0.16, 0.12)
    # In multiples of `width`.
    WIDTHS = (0.4, 1.0, 1.8)

    def __init__(self, width: Array, start: Array) -> None:
        self._plays = [Play(w * np.asarray(width), start) for w in self.WIDTHS]

    def step(self, driver: Array) -> Array:
        """Return the output for a new input."""
        out = (1 - sum(self.SHARES)) * driver
        for share, play in zip(self.SHARES, self._plays, strict=True):
            out = out + share * play.step(driver)
        return np.asarray(out)


def orifice(upstream: Array, downstream: Array) -> Array:
    """Return the flow of air through an orifice, in the unit of the absolute pressures.

    Isentropic flow with heat ratio 1.4 (ISO 6358 approximates it by an ellipse): 0.685 of the upstream pressure when
    choked, and 0 if the downstream pressure is higher.
    """
    ratio = np.clip(downstream / np.maximum(upstream, _TINY), CRITICAL_RATIO, 1.0)
    return np.asarray(upstream * np.sqrt(7.0 * np.maximum(ratio ** (2 / 1.4) - ratio ** (2.4 / 1.4), 0.0)))


def arrivals(sent_s: Array, delay_s: float, jitter_s: float, random: np.random.Generator) -> Array:
    """Return the arrival time of each command of a queue, s; a late command also delays the next one."""
    late = random.exponential(jitter_s, len(sent_s)) if jitter_s > 0 else 0.0
    return np.maximum.accumulate(sent_s + delay_s + late)


def held(t_s: Array, arrived_s: Array, values: Array) -> Array:
    """Return the newest value that has arrived at each time, or the first value before any has."""
    return np.asarray(values[np.maximum(np.searchsorted(arrived_s, t_s, side="right") - 1, 0)])


def dead_zone(value: Array, width: Array) -> Array:
    """Return a value after a dead zone that is `width` wide on each side."""
    return np.asarray(value - np.minimum(np.maximum(value, -width), width))


def coloured(count: int, step_s: float, sigma: float, corner_hz: float, random: np.random.Generator) -> Array:
    """Return noise with a corner frequency: a first-order autoregression."""
    kept = math.exp(-2 * math.pi * corner_hz * step_s)
    white = random.normal(0.0, sigma * math.sqrt(1 - kept * kept), count)
    before = random.normal(0.0, sigma)
    return np.asarray(lfilter([1.0], [1.0, -kept], white, zi=[kept * before])[0])


def grown(clock_s: Array) -> Array:
    """Return the share of a slow change that has happened at a time."""
    return np.asarray(1 - np.exp(-clock_s / CHANGE_S))


def worn(p: Mapping[str, Array], clock_s: Array) -> Array:
    """Return the share of play or friction that is present at a time; it grows from `wear` to 1."""
    return np.where(p["wear"] > 0, p["wear"] + (1 - p["wear"]) * grown(clock_s), 1.0)


def lanes_of(machine: str, lanes: Sequence[Mapping[str, float]], defaults: Mapping[str, float]) -> dict[str, Array]:
    """Return the parameters of all lanes as one array per name; defaults are neutral.

    Raises:
        KeyError: A name is not in `defaults`.
    """
    check_names(machine, lanes, defaults)
    return {name: np.array([lane.get(name, value) for lane in lanes], float) for name, value in defaults.items()}


def check_names(machine: str, lanes: Sequence[Mapping[str, Any]], known: Collection[str]) -> None:
    """Raise KeyError if a lane has a parameter of another name."""
    unknown = {name for lane in lanes for name in lane} - set(known)
    if unknown:
        raise KeyError(f"{machine} has no parameter of this name: {', '.join(sorted(unknown))}")
