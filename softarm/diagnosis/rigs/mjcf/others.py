"""Measured motion of the other joints of a mechanism, which loads a joint."""

from collections.abc import Mapping, Sequence

import numpy as np

from softarm.diagnosis.data.trials import Trial
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.grid import Grid
from softarm.diagnosis.rigs.mjcf.mechanism import Joint, Mechanism
from softarm.diagnosis.rigs.motion import Motion, differences, smoothed
from softarm.diagnosis.rigs.scales import white_noise

# Column -> position, speed and acceleration, [T] each.
Around = Mapping[str, tuple[Array, Array, Array]]


def measured(mechanism: Mechanism, joint: Joint, trials: Sequence[Trial], own: Sequence[Motion]) -> list[Around]:
    """Return the motion of the other measured columns of each trial, on the grid of the joint's own motion."""
    return [_measured(mechanism, joint, trial, m.grid) for trial, m in zip(trials, own, strict=True)]


def _measured(mechanism: Mechanism, joint: Joint, trial: Trial, grid: Grid) -> Around:
    found, poses = {}, {name for pose in mechanism.poses for name in pose.columns}
    for series in (trial.channels[name] for name in ("measured", "base") if name in trial.channels):
        for pose in mechanism.poses:
            series = pose.continuous(series, trial.source)
        for name in series.columns:
            if name in poses:
                found[name] = smoothed(series, name, grid)
            elif name != joint.name:
                mechanism.joint(name)
                found[name] = differences(series, name, grid)
    return found


def smooth(around: Around) -> Around:
    """Return the motion with accelerations that are averaged over three samples."""
    third = np.full(3, 1 / 3)
    return {name: (x, v, np.convolve(a, third, "same")) for name, (x, v, a) in around.items()}


def noisy(around: Sequence[Around], steps_s: Sequence[float]) -> list[Around]:
    """Return the motion of each trial with once more the noise of its positions; steps_s: spacing of the samples, s."""
    random = np.random.default_rng(0)
    return [_noisy(each, step_s, random) for each, step_s in zip(around, steps_s, strict=True)]


def _noisy(around: Around, step_s: float, random: np.random.Generator) -> Around:
    found = {}
    for name, (position, speed, acceleration) in around.items():
        noise = white_noise([position]) * random.normal(size=len(position))
        curve = np.zeros_like(noise)
        curve[1:-1] = np.diff(noise, 2) / step_s**2
        found[name] = position + noise, speed + np.gradient(noise, step_s), acceleration + curve
    return found
