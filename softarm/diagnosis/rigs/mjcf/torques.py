"""Torques that the measured motion of a joint needs, and how they change with bodies and base."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.answer.evidence import rms
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.grid import time_since_change
from softarm.diagnosis.rigs.laws import joint as laws
from softarm.diagnosis.rigs.mjcf.slopes import Slopes
from softarm.diagnosis.rigs.motion import STILL, Motion, summed_twice

# Share of a tilt's torque that a wrong zero or a constant torque leaves, up to which recordings cannot separate them.
TILT_SHARE = 0.1


class Torques:
    """Torques of one joint along the motion of all its recordings, [M]; without friction."""

    def __init__(self, slopes: Slopes, motions: Sequence[Motion]) -> None:
        """Join the motions; slopes: rigid-body terms of all recordings, and their changes."""
        self._slopes = slopes
        self._position = np.concatenate([m.position for m in motions])
        self._speed = np.concatenate([m.speed for m in motions])
        self._acceleration = np.concatenate([m.acceleration for m in motions])

    def total(self, terms: Array) -> Array:
        """Return the torque with the joint's own acceleration; terms: [ROWS, M]."""
        return torque(terms, self._position, self._speed, self._acceleration)

    def load(self, terms: Array) -> Array:
        """Return the torque without the joint's own acceleration; terms: [ROWS, M]."""
        return load(terms, self._position, self._speed)

    def tilted(self) -> Mapping[str, Array]:
        """Return the torque per rad of the base's tilt, by axis."""
        return {axis: self.load(change) for axis, change in self._slopes.changes.tilted.items()}

    def doubling_kg(self, felt: float) -> tuple[float, ...]:
        """Return the payloads that double the torque, kg, at the usual distance along each axis of the last link, [3].

        Args:
            felt: share of the torque below which a payload has no effect; its mass is infinite then.
        """
        far, needed = 2 * self._slopes.reach_m, rms(self.total(self._slopes.base))
        places = (far, 0.0, 0.0), (0.0, far, 0.0), (0.0, 0.0, far)
        per_kg = [rms(self.total(self._slopes.loaded(at_m))) for at_m in places]
        return tuple(needed / each if each > felt * needed else math.inf for each in per_kg)

    def like_tilt(self, axes: Sequence[str], follows: bool) -> str:
        """Return the effect whose torque is that of a tilted base, or an empty string.

        Args:
            axes: axes about which a tilt loads the joint.
            follows: whether a position loop drives the joint.
        """
        falls = self._slopes.base[laws.BY_POSITION]
        constant = "command_bias" if follows else "torque_offset"
        tilted = self.tilted()
        for name, other in (("sensor_bias", falls), (constant, np.ones_like(falls))):
            alike = [rms(_without(tilted[axis], other)) < TILT_SHARE * rms(tilted[axis]) for axis in axes]
            if alike and all(alike):
                return name
        return ""


def split(terms: Array, motions: Sequence[Motion]) -> list[Array]:
    """Return the terms [ROWS, T] of each recording; terms: of all recordings, [ROWS, M]."""
    return np.split(terms, np.cumsum([len(m.seen) for m in motions])[:-1], axis=1)


def load(terms: Array, position: Array, speed: Array) -> Array:
    """Return the load torque along a motion, [T]; terms: [ROWS, T]."""
    return np.asarray(terms[laws.LOAD] + terms[laws.BY_POSITION] * position + terms[laws.BY_SPEED] * speed)


def torque(terms: Array, position: Array, speed: Array, acceleration: Array) -> Array:
    """Return the torque that a motion needs without friction, [T]; terms: [ROWS, T]."""
    return np.asarray(load(terms, position, speed) + terms[laws.INERTIA] * acceleration)


def features(
    motion: Motion, edges: NDArray[np.int64], terms: Array, sent: Array | None, speed: float
) -> dict[str, Array]:
    """Return the features of a trial's samples for a flexible model of the residual, by name, [T] each.

    Args:
        motion: motion of the joint.
        edges: first samples of the windows, and the end.
        terms: rigid-body terms, [ROWS, T].
        sent: command at each sample, [T], or None without an actuator.
        speed: large speed of the joint, rad/s or m/s.
    """
    t, v = motion.grid.t_s, motion.speed
    direction = np.sign(np.where(np.abs(v) > STILL * speed, v, 0.0))
    found = {
        "torque": load(terms, motion.position, v),
        "speed": v,
        "direction": direction,
        "position": motion.position,
        "time since reversal": time_since_change(t, np.sign(v)),
        "time in the window": t - t[np.repeat(edges[:-1], np.diff(edges))],
    }
    if sent is not None:
        found["command"] = sent
    for name, values in {"direction": direction, "speed": v, "drag": v * np.abs(v)}.items():
        found[f"{name}, summed"] = summed_twice(values, edges, motion.grid.step_s)
    return found


def _without(values: Array, other: Array) -> Array:
    """Return what a multiple of other values does not explain of some values, [T]."""
    squares = float(other @ other)
    return values - (other @ values) / squares * other if squares else values
