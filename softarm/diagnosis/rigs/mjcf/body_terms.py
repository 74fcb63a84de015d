"""Rigid-body terms and torques of a joint along the measured motion of its mechanism, and their changes with bodies."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.answer.evidence import rms
from softarm.diagnosis.data.trials import Series, Trial
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.grid import Grid, time_since_change
from softarm.diagnosis.rigs.laws import joint as laws
from softarm.diagnosis.rigs.mjcf.loads import powers
from softarm.diagnosis.rigs.mjcf.mechanism import Changes, Course, Joint, Mechanism
from softarm.diagnosis.rigs.mjcf.noise import correlations, drawn
from softarm.diagnosis.rigs.motion import STILL, Motion, differences, smoothed, summed_twice

# Changes of a length at which the terms are computed.
LENGTH_SHARES = (-0.1, 0.1)
# Places of a payload whose change is kept.
KEPT = 8
# Share of a tilt's torque that a wrong zero or a constant torque leaves, up to which recordings cannot separate them.
TILT_SHARE = 0.1
# Place of a payload along the axes of the last link.
Place = tuple[float, float, float]
# Column -> position, speed and acceleration, [T] each.
Around = Mapping[str, tuple[Array, Array, Array]]


class BodyChange(NamedTuple):
    """Change of the rigid-body terms: of the bodies behind a joint, of the base, and of a simulation's steps."""

    mass_share: float
    payload_kg: float
    payload_m: Place  # along the axes of the last link
    length_share: float
    tilts_rad: tuple[tuple[str, float], ...] = ()  # axis, angle
    part_shares: tuple[tuple[str, float], ...] = ()  # first body of a part, share of its mass
    late_s: float = 0.0  # time by which forces have earlier speeds


class BodyTerms:
    """Rigid-body terms of a joint in all its trials, [ROWS, M], and their changes, each computed at its first use.

    The measured motion of the other joints loads the joint. Masses and tilts enter linearly, lengths as a polynomial of
    second degree.

    Attributes:
        around: motion of the other measured columns of each trial, on the grid of the joint's own motion.
        courses: motion of the whole model in each trial.
        base: terms of the model.
        reach_m: usual distance of a payload from the last joint; 0 on a balanced link.
        loaded: returns the change per kg of a payload at a place.
        longer: returns the change at one of LENGTH_SHARES of the joint's link.
        late: returns the change with forces of the speeds of some time before.
        disturbed: returns the terms with more noise, or smoothing, of the other joints; see `_disturbed`.
    """

    def __init__(self, mechanism: Mechanism, joint: Joint, trials: Sequence[Trial], own: Sequence[Motion]) -> None:
        """Compute the terms of the model; own: motion of the joint in each trial."""
        self._mechanism, self._joint, self._own = mechanism, joint, own
        self._link = mechanism.last_link(joint)
        self.reach_m = self._link.reach_m
        self.around = [_measured(mechanism, joint, trial, m.grid) for trial, m in zip(trials, own, strict=True)]
        self.courses = self._courses(own, self.around)
        self.base = self._terms(self.courses)
        self.loaded = lru_cache(KEPT)(self._loaded)
        self.longer = cache(lambda share: self._terms(self.courses, share) - self.base)
        self.late, self.disturbed = cache(self._late), cache(self._disturbed)

    @cached_property
    def changes(self) -> Changes:
        """Changes with each part's mass, a payload and a tilt of the base, [ROWS, M] each."""
        found = [self._mechanism.changes(self._joint, course) for course in self.courses]
        parts, points, tilted = zip(*found, strict=True)
        return Changes(_joined(parts), np.concatenate(points, axis=-1), _joined(tilted))

    @cached_property
    def heavier(self) -> Array:
        """Change per share of all masses behind the joint, [ROWS, M]."""
        return np.asarray(sum(self.changes.parts.values()))

    def at(self, change: BodyChange, start: Array | None = None) -> Array:
        """Return the terms with changed bodies, [ROWS, M]; start: terms to start from, instead of the base."""
        found = (self.base if start is None else start).copy()
        if change.mass_share:
            found += change.mass_share * self.heavier
        if change.payload_kg:
            found += change.payload_kg * self.loaded(change.payload_m)
        if change.length_share:
            found += self._stretched(change.length_share)
        for axis, angle in change.tilts_rad:
            found += angle * self.changes.tilted[axis]
        for part, share in change.part_shares:
            found += share * self.changes.parts[part]
        if change.late_s:
            found += self.late(change.late_s)
        return found

    def terms_along(self, own: Sequence[Motion]) -> list[Array]:
        """Return the rigid-body terms of each trial along another motion of the joint, [ROWS, T]."""
        return [self._mechanism.terms(self._joint, course) for course in self._courses(own, self.around)]

    def smoothed(self, smooth: Callable[[Iterable[Array]], Array]) -> dict[str, tuple[Array, Array, Array]]:
        """Return position, speed and acceleration of each column, the joint's too, smoothed; smooth: of recordings."""
        own = {self._joint.name: [(m.position, m.speed, m.acceleration) for m in self._own]}
        columns = own | {name: [around[name] for around in self.around] for name in self.around[0]}
        return {
            name: (smooth(x for x, _, _ in each), smooth(v for _, v, _ in each), smooth(a for _, _, a in each))
            for name, each in columns.items()
        }

    def _loaded(self, at_m: Place) -> Array:
        return np.tensordot(powers(self._link.place(at_m)), self.changes.point, 1)

    def _stretched(self, share: float) -> Array:
        """Return the change by a longer link, from those of LENGTH_SHARES, [ROWS, M]."""
        low, high = LENGTH_SHARES
        lower, higher = (share * (share - b) / (a * (a - b)) for a, b in ((low, high), (high, low)))
        return np.asarray(lower * self.longer(low) + higher * self.longer(high))

    def _late(self, late_s: float) -> Array:
        """Return the change with forces of the speeds of some time before, [ROWS, M]."""
        own = [replace(m, speed=m.speed - late_s * m.acceleration) for m in self._own]
        around = [{name: (x, v - late_s * a, a) for name, (x, v, a) in each.items()} for each in self.around]
        found = self._terms(self._courses(own, around))
        found[laws.INERTIA] -= late_s * found[laws.BY_SPEED]  # the joint's own simulated speed
        return found - self.base

    def _disturbed(self, noisy: bool, smooth: bool) -> Array:
        """Return the rigid-body terms with other motion of the other joints, [ROWS, M].

        Args:
            noisy: whether their positions have once more the noise that they have.
            smooth: whether their accelerations are averaged over three samples.
        """
        around = self.around
        if noisy:
            parts = zip(around, self._own, self._noise, strict=True)
            around = [_noisy(each, m.grid.step_s, noise) for each, m, (noise, _) in parts]
        if smooth:
            around = [_smooth(each) for each in around]
        return self._terms(self._courses(self._own, around))

    @cached_property
    def shared_noise(self) -> Array:
        """Part of the joint's own noise that comes with the noise of the other joints' positions, [M]."""
        return np.concatenate([shared for _, shared in self._noise])

    @cached_property
    def _noise(self) -> list[tuple[Array, Array]]:
        """Noise of the other columns in each trial, [C, T], and the part of the joint's own that comes with it, [T]."""
        random, alike = np.random.default_rng(0), dict[tuple[str, ...], list[list[Array]]]()
        readings = []
        for around, m in zip(self.around, self._own, strict=True):
            own = np.where(np.isfinite(m.seen), m.seen, m.position)
            readings.append([*(x for x, _, _ in around.values()), own])
            alike.setdefault(tuple(around), []).append(readings[-1])
        shared = {columns: correlations(trials) for columns, trials in alike.items()}
        return [drawn(x, shared[tuple(around)], random) for x, around in zip(readings, self.around, strict=True)]

    def _terms(self, courses: Sequence[Course], longer: float = 0.0) -> Array:
        return np.concatenate([self._mechanism.terms(self._joint, course, longer) for course in courses], axis=1)

    def _courses(self, own: Sequence[Motion], around: Sequence[Around]) -> list[Course]:
        found = []
        for m, each in zip(own, around, strict=True):
            motion = {self._joint.name: (m.position, m.speed, m.acceleration)}
            found.append(self._mechanism.course(self._joint, {**motion, **each}))
        return found


class Torques:
    """Torques of one joint along the motion of all its recordings, [M]; without friction."""

    def __init__(self, bodies: BodyTerms, motions: Sequence[Motion]) -> None:
        """Join the motions; bodies: rigid-body terms of all recordings, and their changes."""
        self._bodies = bodies
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
        return {axis: self.load(change) for axis, change in self._bodies.changes.tilted.items()}

    def doubling_kg(self, felt: float) -> tuple[float, ...]:
        """Return the payloads that double the torque, kg, at the usual distance along each axis of the last link, [3].

        Args:
            felt: share of the torque below which a payload has no effect; its mass is infinite then.
        """
        far, needed = 2 * self._bodies.reach_m, rms(self.total(self._bodies.base))
        places = (far, 0.0, 0.0), (0.0, far, 0.0), (0.0, 0.0, far)
        per_kg = [rms(self.total(self._bodies.loaded(at_m))) for at_m in places]
        return tuple(needed / each if each > felt * needed else math.inf for each in per_kg)

    def like_tilt(self, axes: Sequence[str], follows: bool) -> str:
        """Return the effect whose torque is that of a tilted base, or an empty string.

        Args:
            axes: axes about which a tilt loads the joint.
            follows: whether a position loop drives the joint.
        """
        falls = self._bodies.base[laws.BY_POSITION]
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


def continuous(mechanism: Mechanism, trial: Trial) -> Iterator[Series]:
    """Yield the measured channels of a trial, with quaternions that do not change their sign between two rows."""
    for series in (trial.channels[name] for name in ("measured", "base") if name in trial.channels):
        for pose in mechanism.poses:
            series = pose.continuous(series, trial.source)
        yield series


def _measured(mechanism: Mechanism, joint: Joint, trial: Trial, grid: Grid) -> Around:
    found, poses = {}, {name for pose in mechanism.poses for name in pose.columns}
    for series in continuous(mechanism, trial):
        for name in series.columns:
            if name in poses:
                found[name] = smoothed(series, name, grid)
            elif name != joint.name:
                mechanism.joint(name)
                found[name] = differences(series, name, grid)
    return found


def _smooth(around: Around) -> Around:
    third = np.full(3, 1 / 3)
    return {name: (x, v, np.convolve(a, third, "same")) for name, (x, v, a) in around.items()}


def _noisy(around: Around, step_s: float, noise: Array) -> Around:
    found = {}
    for (name, (position, speed, acceleration)), own in zip(around.items(), noise, strict=True):
        curve = np.zeros_like(own)
        curve[1:-1] = np.diff(own, 2) / step_s**2
        found[name] = position + own, speed + np.gradient(own, step_s), acceleration + curve
    return found


def _joined(parts: Sequence[Mapping[str, Array]]) -> dict[str, Array]:
    """Return the arrays of all trials one after the other, by name."""
    return {name: np.concatenate([each[name] for each in parts], axis=-1) for name in parts[0]}
