"""Noise of a joint's readings beside that of the other joints, and averages over samples that reduce it."""

import math
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d

from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.scales import ORDERS, white_noise

# Noise as a share of a joint's travel in a window from which samples are averaged, and the averages per period.
NOISY, AVERAGES = 0.01, 20
# Correlation between the noise of two readings below which they count as independent, and the same times the root of
# the number of samples: four standard deviations by chance, of differences of sixth order.
CORRELATED, CHANCE = 0.3, 7.1
# Largest relative difference between estimates from two orders of differences, of white noise; and a difference in its
# medians that counts no further.
WHITE, OUTLYING = 0.15, 4.0
# Share of a joint's own noise that remains at least where that of the other joints cancels it.
UNCANCELLED = 0.5
# Share of the largest eigenvalue below which correlations count as singular.
SINGULAR = 1e-3


def samples_averaged(noise_share: float, period_s: float, step_s: float) -> int:
    """Return over how many samples a gap is averaged: 1 for usual encoders, more for noisy motion capture.

    The mean of n samples has the white noise of one over the root of n; rounding by a coarse encoder does not shrink.
    The time of an average stays short beside the period of the motion.

    Args:
        noise_share: RMS of the white noise over that of the motion.
        period_s: period of the usual motion.
        step_s: sampling interval.
    """
    most = max(int(period_s / AVERAGES / step_s), 1)
    return int(np.clip((noise_share / NOISY) ** 2, 1, most))


def averaged(values: Array, trials: Sequence[slice], samples: int) -> Array:
    """Return moving averages of values [P, M] within each trial; values that are NaN stay so and do not count."""
    if samples == 1:
        return values
    found, seen = np.full_like(values, np.nan), np.isfinite(values)
    for part in trials:
        kept = seen[:, part]
        total = uniform_filter1d(np.where(kept, values[:, part], 0.0), samples, axis=1, mode="constant")
        share = uniform_filter1d(kept.astype(float), samples, axis=1, mode="constant")
        np.divide(total, share, out=found[:, part], where=kept)
    return found


def combined(own: float, felt: float, covariance: float) -> float:
    """Return the RMS of a joint's own noise with that which it feels from the other joints, and which may cancel it."""
    apart = float(np.hypot(own, felt))
    return max(apart * math.sqrt(max(1 + 2 * covariance / apart**2, 0.0)), UNCANCELLED * own)


def correlations(trials: Sequence[Sequence[Array]]) -> Array:
    """Return the correlation of the white noise of each two of C readings, [C, C]; small ones are 0.

    Angles from the same tracked points share their noise: a point that is off bends the joint before it one way and
    the joint behind it the other way. Smooth motion vanishes in differences of high order. What has not vanished
    shrinks from one order to the next.

    Args:
        trials: the readings of each trial, [C, T].
    """
    lower, higher = (
        np.concatenate([np.diff(each, order, axis=1) for each in trials], axis=1)
        / math.sqrt(math.comb(2 * order, order))
        for order in ORDERS[-2:]
    )
    sizes = [np.maximum(np.median(np.abs(each), axis=1), 1e-12) for each in (lower, higher)]
    white = np.abs(sizes[1] / sizes[0] - 1) < WHITE
    usual = np.clip(higher / sizes[1][:, None], -OUTLYING, OUTLYING)
    size, count = np.maximum(np.sqrt(np.mean(usual**2, axis=1)), 1e-12), usual.shape[1]
    found = usual @ usual.T / count / np.outer(size, size)
    found[(np.abs(found) < max(CORRELATED, CHANCE / math.sqrt(count))) | ~np.outer(white, white)] = 0.0
    np.fill_diagonal(found, 1.0)
    return np.asarray(found)


def drawn(readings: Sequence[Array], shared: Array, random: np.random.Generator) -> tuple[Array, Array]:
    """Return noise like that of other joints' readings, and the part of a joint's own noise that comes with it.

    Args:
        readings: readings of C other joints and of the joint in one trial, [T] each.
        shared: correlations of their noise, [C + 1, C + 1].
        random: generator of the noise.

    Returns:
        Noise of the other joints [C, T], and the own part [T], which is 0 for independent readings.
    """
    sizes, among, between = np.array([white_noise([x]) for x in readings]), shared[:-1, :-1], shared[-1, :-1]
    values, axes = np.linalg.eigh(among)
    root = axes * np.sqrt(np.maximum(values, 0.0)) @ axes.T
    units = root @ random.normal(size=(len(among), len(readings[-1])))
    own = sizes[-1] * between @ np.linalg.pinv(among, SINGULAR, hermitian=True) @ units
    return sizes[:-1, None] * units, np.asarray(own)
