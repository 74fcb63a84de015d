"""Measured motion of the other joints of a mechanism, which loads a joint."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, cached_property

import numpy as np

from softarm.diagnosis.data.trials import Series, Trial
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.grid import Grid
from softarm.diagnosis.rigs.laws import joint as laws
from softarm.diagnosis.rigs.mjcf.mechanism import Changes, Course, Joint, Mechanism
from softarm.diagnosis.rigs.mjcf.noise import correlations, drawn
from softarm.diagnosis.rigs.motion import Motion, differences, smoothed

# Column -> position, speed and acceleration, [T] each.
Around = Mapping[str, tuple[Array, Array, Array]]


class OtherJoints:
    """Measured motion of the other joints in every trial of a joint.

    Attributes:
        around: motion of the other measured columns of each trial, on the grid of the joint's own motion.
        courses: motion of the whole model in each trial.
        disturbed: rigid-body terms [ROWS, M] with more noise, or smoothing, of the other joints; see `_disturbed`.
    """

    def __init__(self, mechanism: Mechanism, joint: Joint, trials: Sequence[Trial], own: Sequence[Motion]) -> None:
        """Prepare the motion of the whole model; own: motion of the joint in each trial."""
        self._mechanism, self._joint, self._own = mechanism, joint, own
        self.around = [_measured(mechanism, joint, trial, m.grid) for trial, m in zip(trials, own, strict=True)]
        self.courses = self._courses(own, self.around)
        self.disturbed = cache(self._disturbed)

    def terms(self, longer: float = 0.0) -> Array:
        """Return the rigid-body terms of all trials one after the other, [ROWS, M]; longer: see `Mechanism.terms`."""
        return self._terms(self.courses, longer)

    def changes(self) -> Changes:
        """Return the changes of the rigid-body terms of all trials one after the other."""
        found = [self._mechanism.changes(self._joint, course) for course in self.courses]
        parts, points, tilted = zip(*found, strict=True)
        return Changes(_joined(parts), np.concatenate(points, axis=-1), _joined(tilted))

    def terms_along(self, own: Sequence[Motion]) -> list[Array]:
        """Return the rigid-body terms of each trial along another motion of the joint, [ROWS, T]."""
        return [self._mechanism.terms(self._joint, course) for course in self._courses(own, self.around)]

    def terms_late(self, late_s: float) -> Array:
        """Return the rigid-body terms of all trials with the speeds of some time before, [ROWS, M]."""
        own = [replace(m, speed=m.speed - late_s * m.acceleration) for m in self._own]
        around = [{name: (x, v - late_s * a, a) for name, (x, v, a) in each.items()} for each in self.around]
        found = self._terms(self._courses(own, around))
        found[laws.INERTIA] -= late_s * found[laws.BY_SPEED]  # the joint's own simulated speed
        return found

    def smoothed(self, smooth: Callable[[Iterable[Array]], Array]) -> dict[str, tuple[Array, Array, Array]]:
        """Return position, speed and acceleration of each column, the joint's too, smoothed; smooth: of recordings."""
        own = {self._joint.name: [(m.position, m.speed, m.acceleration) for m in self._own]}
        columns = own | {name: [around[name] for around in self.around] for name in self.around[0]}
        return {
            name: (smooth(x for x, _, _ in each), smooth(v for _, v, _ in each), smooth(a for _, _, a in each))
            for name, each in columns.items()
        }

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
