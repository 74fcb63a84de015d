"""Signals by which the description of a joint is checked, smoothed against the noise of accelerations."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.mjcf.checks import Compared
from softarm.diagnosis.rigs.mjcf.mechanism import Joint
from softarm.diagnosis.rigs.mjcf.torques import torque
from softarm.diagnosis.rigs.motion import Motion

# Share of a command's power at frequencies that the smoothing keeps, and its width at most, in lengths of a recording.
KEPT, WIDEST = 0.9, 0.025


# Returns smoothed signals of all recordings one after the other, [M]; it takes those of each recording, [T].
Smooth = Callable[[Iterable[Array]], Array]


def smoother(
    motions: Sequence[Motion], sent: Sequence[Array], free: Sequence[NDArray[np.bool_]], width: float = 1.0
) -> Smooth:
    """Return the smoothing that keeps most of the commands, at samples without a contact.

    The double difference of an encoder's noise is larger than most accelerations, but lies at higher frequencies than
    the command. A weighted mean of both keeps their ratio.

    Args:
        motions: motion of each recording.
        sent: its command, [T of the recording].
        free: samples without a contact or a limit, [T of the recording].
        width: factor of the smoothing's width.
    """
    widths = [width * _width(s, m.grid.step_s) for s, m in zip(sent, motions, strict=True)]

    def smooth(signals: Iterable[Array]) -> Array:
        recordings = zip(signals, free, widths, strict=True)
        return np.concatenate([_smooth(values, used, width)[used] for values, used, width in recordings])

    return smooth


def compared(
    joint: Joint,
    motions: Sequence[Motion],
    sent: Sequence[Array],
    smooth: Smooth,
    terms: Callable[[Sequence[Motion]], Iterable[Array]],
) -> Compared:
    """Return command and motion of a joint in all recordings, smoothed alike.

    Args:
        joint: joint of the model, with the actuator that drives it.
        motions: motion of each recording.
        sent: its command, [T of the recording].
        smooth: result of `smoother`.
        terms: returns the rigid-body terms of each recording along a motion of the joint, [ROWS, T].
    """
    assert joint.actuator is not None
    factor = 1.0 if joint.follows else joint.actuator.scale

    def needed(along: Sequence[Motion]) -> Array:
        return smooth(_needed(joint, each, m) for each, m in zip(terms(along), along, strict=True))

    return Compared(
        seen=smooth(m.position for m in motions),
        command=smooth(factor * s for s in sent),
        needed=needed(motions),
        friction=np.stack((smooth(np.sign(m.speed) for m in motions), smooth(m.speed for m in motions)), axis=1),
        mirrored=lambda: needed([m.mirrored() for m in motions]),
    )


def _needed(joint: Joint, terms: Array, motion: Motion) -> Array:
    friction = joint.viscous * motion.speed + joint.friction * np.sign(motion.speed)
    spring = 0.0 if joint.follows else joint.spring * (motion.position - joint.rest)
    return torque(terms, motion.position, motion.speed, motion.acceleration) + friction + spring


def _width(command: Array, step_s: float) -> float:
    """Return the standard deviation of the Gaussian that keeps most of a command, in samples."""
    power = np.cumsum(np.abs(np.fft.rfft(command - np.mean(command))) ** 2)
    fastest_hz = np.fft.rfftfreq(len(command), step_s)[max(int(np.searchsorted(power, KEPT * power[-1])), 1)]
    return min(float(1 / (2 * np.pi * fastest_hz * step_s)), WIDEST * len(command))


def _smooth(values: Array, used: NDArray[np.bool_], width: float) -> Array:
    """Return the weighted mean of the used values around each sample, [T]."""
    total, weight = (gaussian_filter1d(x, width, mode="constant") for x in (np.where(used, values, 0.0), 1.0 * used))
    return np.asarray(total / np.maximum(weight, 1e-300))
