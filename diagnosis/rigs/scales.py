"""What a recording shows of its rig's time scales, ranges and noise: bounds and usual sizes of what is fitted to it.

No table by unit: a valve of seconds and an axis of milliseconds, kilopascals and counts, each from its own data.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_filter

from softarm.diagnosis.engine.view import Array

SHARE = 0.01  # of a trial: what is seen for less of it may be a glitch
SIGMAS = 4.0  # of noise: what is certainly above it
SURE = 0.95  # of what was seen: no limit lies below
ORDERS = (3, 4, 5, 6)  # of differences that noise is read from: a smooth signal is gone from the higher ones
LATEST = 0.25  # of the longest trial: whatever is later cannot be told from not following at all
SMOOTHEST = 0.05  # of a trial: the longest stretch over which a slope is taken
SHIFTS = 40
FORGETS, LATES = 6.0, 3.0  # a sine goes round in six of the times in which it half forgets itself; of the lateness
STRETCHES_LEAST, STRETCHES_MOST = 5, 40  # of a trial
REPEATED = 1e-6  # of the command's range: two that differ by less are one command


class Span(NamedTuple):
    """Bounds of a parameter on one rig, and its usual change; neutral: where the registry's is not the rig's."""

    low: float
    high: float
    usual: float
    neutral: float | None = None


@dataclass(frozen=True, slots=True)
class Scales:
    """Of one stage; lengths in the unit of what is measured."""

    step_s: float  # between samples
    longest_s: float  # of the trials
    late_s: float  # by how much the measured follows the command, about
    reach: float  # range of command and measured together
    top: float  # certainly reached for a while
    commanded: float  # highest command
    rise: float  # a slope certainly exceeded for a while; likewise
    fall: float
    acceleration: float  # either way
    noise: float  # white, RMS of the measured

    @property
    def share(self) -> float:
        """A change that one would notice."""
        return max(0.03 * self.reach, 2 * self.noise)


def scales(t_s: Sequence[Array], commands: Sequence[Array], measured: Sequence[Array]) -> Scales:
    """Read them off a stage's trials, each on uniform stamps; commands in the measured unit, NaN where not measured."""
    step = float(np.median([np.median(np.diff(t)) for t in t_s]))
    low = min(min(_finite(m).min(), c.min()) for m, c in zip(measured, commands, strict=True))
    high = max(max(_finite(m).max(), c.max()) for m, c in zip(measured, commands, strict=True))
    sigma = white_noise(measured)
    longest = max(float(t[-1] - t[0]) for t in t_s)
    reach = max(float(high - low), 1e-12)
    top = max(float(np.quantile(_finite(m), 1 - SHARE)) for m in measured) - SIGMAS * sigma
    return Scales(
        step,
        longest,
        max(lateness(step, commands, measured, LATEST * longest), step),
        reach,
        top,
        max(float(c.max()) for c in commands),
        fastest(measured, step, 1, sigma),
        fastest([-m for m in measured], step, 1, sigma),
        max(fastest(measured, step, 2, sigma), fastest([-m for m in measured], step, 2, sigma)),
        sigma,
    )


def white_noise(measured: Iterable[Array]) -> float:
    """RMS of the white noise in signals: from high differences, where what is smooth has gone; the least of them."""
    found = [np.concatenate([np.diff(m, order) for m in measured]) for order in ORDERS]
    sizes = [
        1.4826 * np.nanmedian(np.abs(d)) / math.sqrt(math.comb(2 * k, k)) for d, k in zip(found, ORDERS, strict=True)
    ]
    return float(min(sizes))


def fastest(measured: Sequence[Array], step_s: float, order: int, noise: float) -> float:
    """An upward slope (order 1) or curvature (order 2) that the signals certainly exceed for SHARE of a trial.

    Polynomials over stretches of many lengths, less what noise makes of them: each is a mean of the true derivative
    with positive weights, so the true one is at least as large somewhere.
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
    """RMS of a polynomial's derivative over white noise of one."""
    impulse = np.zeros(2 * width - 1)
    impulse[width - 1] = 1.0
    taps = savgol_filter(impulse, width, order, deriv=order, delta=step_s, mode="constant")
    return float(np.sqrt(taps @ taps))


def lateness(step_s: float, commands: Sequence[Array], measured: Sequence[Array], most_s: float) -> float:
    """By how much, to a tenth or so, the measured signals come after their commands: the shift that correlates best."""
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
    """Seconds after which a recording says something new: about a turn of its motion, or of what follows it late."""
    found = max(
        FORGETS * float(np.median([_half_forgotten(t, m) for t, m in zip(t_s, measured, strict=True)])), LATES * late_s
    )
    usual = float(np.median([t[-1] - t[0] for t in t_s]))
    return min(max(found, usual / STRETCHES_MOST), usual / STRETCHES_LEAST)


def _half_forgotten(t_s: Array, measured: Array) -> float:
    """The shift after which a signal is like itself by half."""
    x = np.nan_to_num(measured - np.nanmean(measured))
    power = np.abs(np.fft.rfft(x, 2 * len(x))) ** 2
    alike = np.fft.irfft(power)[: len(x)]
    below = np.flatnonzero(alike < 0.5 * alike[0])
    return float(t_s[below[0] if len(below) else -1] - t_s[0])


def repeatability(commands: Sequence[Array], measured: Sequence[Array]) -> float:
    """RMS by which one flight of a command differs from its mean over flights, without the noise's share taken out; 0
    where no command was flown twice. Trials of one command count from their first samples on.
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


def tracking_spans(s: Scales, speed: bool = False) -> dict[str, Span]:
    """Effect and parameter -> what it may be on a follower with these scales. speed: that is what follows."""
    latest, share = LATEST * s.longest_s, s.share
    time = Span(0.0, latest, min(s.late_s, 0.5 * latest))
    width = Span(0.0, 0.5 * s.reach, share)
    shift = Span(-s.reach, s.reach, share)
    spans = {
        "dead_time.delay": time,
        "latency.delay": time,
        "lag.rise": time,
        "lag.fall": time,
        "gain.scale": Span(-1.0, 2.0, 0.1),
        "gain.offset": shift,
        "sensor_bias.bias": shift,
        "deadband.width": width,
        "backlash.gap": width,
        "hysteresis.width": Span(0.01 * s.reach, s.reach, 0.15 * s.reach),
        "rate_limit.rate": _limit(s.rise, s.reach / s.step_s),
        "rate_limit.fall": _limit(s.fall, s.reach / s.step_s),
        "acceleration_limit.acceleration": _limit(s.acceleration, s.reach / s.step_s**2),
        # From a sine that a trial holds thrice to one that is sampled four times.
        "second_order.frequency": Span(3 / s.longest_s, max(0.25 / s.step_s, 4 / s.longest_s), _frequency(s)),
    }
    if speed:  # of a position it is a dead zone
        spans["coulomb_friction.loss"] = width
    room = s.commanded - s.top
    if room > max(share, 0.0):  # some of the commands were out of reach, or nobody knows of a ceiling
        slack = 0.1 * s.reach
        low = s.top - max(SIGMAS * s.noise, 0.02 * s.reach)
        spans["ceiling.limit"] = Span(low, s.commanded + slack, s.commanded - 0.5 * room, s.commanded + slack)
    return spans


def _limit(seen: float, unseen: float) -> Span:
    """Of a rate: not below what was seen; beyond `unseen` no sample shows it."""
    low = max(SURE * seen, 1e-6 * unseen)
    return Span(low, max(unseen, 10 * low), 1.5 * low)


def _frequency(s: Scales) -> float:
    """Of a resonance that would be about as late as what is seen."""
    return min(max(1 / (2 * math.pi * s.late_s), 4 / s.longest_s), 0.2 / s.step_s)


def _finite(values: Array) -> Array:
    return values[np.isfinite(values)]
