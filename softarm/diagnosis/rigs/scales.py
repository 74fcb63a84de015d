"""Time scales, ranges and noise of a rig, measured from its recordings.

Bounds and usual sizes of fitted parameters come from these, so one code serves a valve that takes seconds and an axis
that takes milliseconds, in any unit.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_filter

from softarm.diagnosis.engine.view import Array

# Share of a trial: a value seen for less of it may be a glitch.
SHARE = 0.01
# Multiple of the noise above which a value is certainly no noise.
SIGMAS = 4.0
# Share of the largest value seen: no limit lies below.
SURE = 0.95
# Orders of differences from which noise is read; a smooth signal vanishes in the higher ones.
ORDERS = (3, 4, 5, 6)
# Share of the longest trial: a larger delay looks like not following at all.
LATEST = 0.25
# Share of a trial: the longest stretch over which a slope is taken.
SMOOTHEST = 0.05
# Number of shifts that are compared for the delay.
SHIFTS = 40
# Length of an independent stretch, in half-lives of the autocorrelation and in delays.
FORGETS, LATES = 6.0, 3.0
# Least and largest number of independent stretches in a trial.
STRETCHES_LEAST, STRETCHES_MOST = 5, 40
# Share of the command's range: two commands that differ by less are the same.
REPEATED = 1e-6


@dataclass(frozen=True, slots=True)
class TrackingScales:
    """Scales of one tracking stage; values are in the unit of the measured channel."""

    step_s: float  # sampling interval
    longest_s: float  # duration of the longest trial
    late_s: float  # approximate delay between command and measured value
    reach: float  # range of command and measured values together
    top: float  # value that the measured signal certainly exceeds for some time
    commanded: float  # highest command
    rise: float  # upward slope that is certainly exceeded for some time
    fall: float  # downward slope, likewise
    acceleration: float  # acceleration in either direction, likewise
    noise: float  # RMS of the white noise in the measured signal

    @property
    def share(self) -> float:
        """Smallest change that matters, in the unit of the measured channel."""
        return max(0.03 * self.reach, 2 * self.noise)


def scales(t_s: Sequence[Array], commands: Sequence[Array], measured: Sequence[Array]) -> TrackingScales:
    """Measure the scales of a stage from its trials, each on uniform stamps.

    Commands are in the measured unit; measured values are NaN where no sample was measured.
    """
    step = float(np.median([np.median(np.diff(t)) for t in t_s]))
    low = min(min(_finite(m).min(), c.min()) for m, c in zip(measured, commands, strict=True))
    high = max(max(_finite(m).max(), c.max()) for m, c in zip(measured, commands, strict=True))
    sigma = white_noise(measured)
    longest = max(float(t[-1] - t[0]) for t in t_s)
    reach = max(float(high - low), 1e-12)
    top = max(float(np.quantile(_finite(m), 1 - SHARE)) for m in measured) - SIGMAS * sigma
    falling = [-m for m in measured]
    return TrackingScales(
        step_s=step,
        longest_s=longest,
        late_s=max(lateness(step, commands, measured, LATEST * longest), step),
        reach=reach,
        top=top,
        commanded=max(float(c.max()) for c in commands),
        rise=fastest(measured, step, 1, sigma),
        fall=fastest(falling, step, 1, sigma),
        acceleration=max(fastest(measured, step, 2, sigma), fastest(falling, step, 2, sigma)),
        noise=sigma,
    )


def white_noise(measured: Iterable[Array]) -> float:
    """Return the RMS of the white noise in signals, from high-order differences in which smooth motion vanishes."""
    found = [np.concatenate([np.diff(m, order) for m in measured]) for order in ORDERS]
    sizes = [
        1.4826 * np.nanmedian(np.abs(d)) / math.sqrt(math.comb(2 * k, k)) for d, k in zip(found, ORDERS, strict=True)
    ]
    return float(min(sizes))


def fastest(measured: Sequence[Array], step_s: float, order: int, noise: float) -> float:
    """Return an upward slope (order 1) or curvature (order 2) that the signals certainly exceed for SHARE of a trial.

    Polynomials are fitted over stretches of many lengths, and the effect of the noise is subtracted. Each result is a
    weighted mean of the true derivative, so the true derivative is at least as large somewhere.
    """
    best = 0.0
    for values in measured:
        half = order
        while 2 * half + 1 <= max(SMOOTHEST * len(values), 2 * order + 1) and 2 * half + 1 <= len(values):
            width = 2 * half + 1
            found = savgol_filter(values, width, order, deriv=order, delta=step_s, mode="constant", cval=np.nan)
            found = found[np.isfinite(found)]
            if len(found) > 1 / SHARE:
                best = max(best, float(np.quantile(found, 1 - SHARE)) - SIGMAS * noise * _gain(width, order, step_s))
            half *= 2
    return best


def _gain(width: int, order: int, step_s: float) -> float:
    """RMS of a polynomial's derivative for white noise with an RMS of one."""
    impulse = np.zeros(2 * width - 1)
    impulse[width - 1] = 1.0
    taps = savgol_filter(impulse, width, order, deriv=order, delta=step_s, mode="constant")
    return float(np.sqrt(taps @ taps))


def lateness(step_s: float, commands: Sequence[Array], measured: Sequence[Array], most_s: float) -> float:
    """Return the delay of the measured signals after their commands, s, within about a tenth; at most `most_s`.

    It is the shift with the best correlation.
    """
    shifts = np.unique(np.round(np.geomspace(1, max(most_s / step_s, 2), SHIFTS)).astype(int))
    shifts = np.concatenate(([0], shifts[shifts < min(len(c) for c in commands) // 2]))
    alike = [_correlation([c[: len(c) - k] for c in commands], [m[k:] for m in measured]) for k in shifts]
    return float(shifts[int(np.argmax(alike))] * step_s)


def _correlation(commands: Sequence[Array], measured: Sequence[Array]) -> float:
    c, m = np.concatenate(commands), np.concatenate(measured)
    kept = np.isfinite(m)
    c, m = c[kept] - c[kept].mean(), m[kept] - m[kept].mean()
    return float(c @ m / math.sqrt(max(float(c @ c) * float(m @ m), 1e-300)))


def stretch(t_s: Sequence[Array], measured: Sequence[Array], late_s: float) -> float:
    """Return the length of a stretch of data that is independent of its neighbours, s.

    late_s is the delay of the measured signal after its command.
    """
    found = max(
        FORGETS * float(np.median([_half_forgotten(t, m) for t, m in zip(t_s, measured, strict=True)])), LATES * late_s
    )
    usual = float(np.median([t[-1] - t[0] for t in t_s]))
    return min(max(found, usual / STRETCHES_MOST), usual / STRETCHES_LEAST)


def _half_forgotten(t_s: Array, measured: Array) -> float:
    """Shift at which a signal's autocorrelation has fallen to a half, s."""
    x = np.nan_to_num(measured - np.nanmean(measured))
    power = np.abs(np.fft.rfft(x, 2 * len(x))) ** 2
    alike = np.fft.irfft(power)[: len(x)]
    below = np.flatnonzero(alike < 0.5 * alike[0])
    return float(t_s[below[0] if len(below) else -1] - t_s[0])


def repeatability(commands: Sequence[Array], measured: Sequence[Array]) -> float:
    """Return the RMS difference between a trial and the mean of all trials with the same command, noise included.

    It is 0 if no command was recorded twice. Trials are compared from their first samples on.
    """
    energy, count = 0.0, 0
    reach = max((float(np.ptp(c)) for c in commands), default=0.0)
    for i in range(len(commands)):
        for j in range(i):
            n = min(len(commands[i]), len(commands[j]))
            if 2 * n < max(len(commands[i]), len(commands[j])):
                continue
            if np.abs(commands[i][:n] - commands[j][:n]).max() <= REPEATED * reach:
                apart = measured[i][:n] - measured[j][:n]
                apart = apart[np.isfinite(apart)]
                energy, count = energy + 0.5 * float(apart @ apart), count + len(apart)
    return math.sqrt(energy / count) if count else 0.0


def _finite(values: Array) -> Array:
    return values[np.isfinite(values)]
