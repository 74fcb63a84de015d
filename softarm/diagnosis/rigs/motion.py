"""Measured motion of one axis or joint, smoothed, and its windows, whose starts a view fits."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.signal import savgol_filter

from softarm.diagnosis.data.trials import Series, Trial, TrialError
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.engine.whitened import BLOCK_S, slices
from softarm.diagnosis.rigs.grid import Grid, grid
from softarm.diagnosis.rigs.scales import STRETCHES_LEAST, STRETCHES_MOST

# Samples are averaged down to this rate, or to this many per period of the motion if that is more.
RATE_HZ, SAMPLES_PER_PERIOD = 100.0, 100
# Length of a window as a share of the usual period: a small force must show, and the error of an inexact model grows
# with the square of the time. BLOCK_WINDOWS windows count as one independent stretch.
WINDOW_PERIODS, SAMPLES_LEAST, BLOCK_WINDOWS = 0.8, 16, 2
# Lengths of smoothing filters, samples; the longest whose residual is at most NOISE_MORE times the noise is used.
SMOOTHED = (5, 9, 17, 33, 65)
NOISE_MORE = 1.3
# Shares of the largest speed up to which an axis rests, and moves slowly.
STILL, SLOW = 0.01, 0.15
# Margin around samples that are left out, s.
MARGIN_S = 0.05
# Uncertainty of times, as a share of the time between two inputs; simulated rigs and joints showed 0.03.
TIMED = 0.05


@dataclass(frozen=True, slots=True)
class Motion:
    """Measured motion of one trial."""

    grid: Grid
    seen: Array  # [T]; NaN in gaps
    position: Array  # [T] smoothed, or integrated from the speed
    speed: Array  # [T]
    acceleration: Array  # [T]
    noise: float
    spread: Array  # [2] uncertainty of position and speed at the start of a window

    def mirrored(self) -> "Motion":
        """Return the motion with readings of the opposite sign."""
        opposite = {name: -getattr(self, name) for name in ("seen", "position", "speed", "acceleration")}
        return replace(self, **opposite)


def motion(g: Grid, column: str, step: float, limit: float, *, speed_alone: bool = False) -> Motion:
    """Return the smoothed motion of a column.

    Args:
        g: measured columns of one trial.
        column: column of the position, or of the speed if `speed_alone`.
        step: resolution of the encoder; 0 if it has none.
        limit: largest acceleration.
        speed_alone: whether the speed is measured instead of the position.
    """
    seen = g.columns[column]
    known = np.isfinite(seen)
    whole = np.interp(g.t_s, g.t_s[known], seen[known])
    noise = max(float(np.std(np.diff(whole, 3))) / np.sqrt(20.0), step / np.sqrt(12.0), 1e-12)
    width = SMOOTHED[0]
    for wider in SMOOTHED[1:]:
        if wider >= len(whole) or np.std(whole - savgol_filter(whole, wider, 2)) > NOISE_MORE * noise:
            break
        width = wider
    smooth, slope = (savgol_filter(whole, width, 2, deriv=d, delta=g.step_s) for d in (0, 1))
    span = width * g.step_s
    if speed_alone:
        spread = np.array([1.0, 3 * noise + 0.1 * limit * span])
        return Motion(g, seen, np.cumsum(smooth) * g.step_s, smooth, slope, noise, spread)
    curve = savgol_filter(whole, width, 2, deriv=2, delta=g.step_s)
    unsure = noise * np.sqrt(12.0 / (width * (width**2 - 1))) / g.step_s
    spread = np.array([5 * noise + 0.1 * limit * span**2, 3 * unsure + 0.1 * limit * span])
    return Motion(g, seen, smooth, slope, curve, noise, spread)


def widened(out: NDArray[np.bool_], step_s: float) -> NDArray[np.bool_]:
    """Return samples that are left out, with a margin before and after each, [T]."""
    return np.asarray(maximum_filter1d(out, 2 * round(MARGIN_S / step_s) + 1, mode="constant"))


def motions(
    trials: Sequence[Trial],
    column: str,
    step: float,
    limit: float,
    *,
    speed_alone: bool = False,
    rate_hz: float = RATE_HZ,
) -> list[Motion]:
    """Return the measured motion of every trial, on grids that are finer for fast motion.

    Args:
        rate_hz: rate down to which samples are averaged, at least.
        trials, column, step, limit, speed_alone: see `motion`.
    """
    rate = rate_hz
    for _ in range(2):
        grids = [grid(t.channel("measured"), rate, (column,)) for t in trials]
        found = [motion(g, column, step, limit, speed_alone=speed_alone) for g in grids]
        finer = SAMPLES_PER_PERIOD / period(found, limit, speed_alone=speed_alone)
        if finer <= rate:
            break
        rate = finer
    return found


def largest_acceleration(trials: Sequence[Trial], column: str, step: float) -> float:
    """Return the largest acceleration of a joint without a few outliers; raise TrialError if it does not move."""
    found = [motion(grid(t.channel("measured"), columns=(column,)), column, step, 0.0) for t in trials]
    largest = float(np.quantile(np.abs(np.concatenate([m.acceleration for m in found])), 0.99))
    if not largest > 0:
        raise TrialError(f"{trials[0].source}: {column} does not move in any trial; leave its column out")
    return largest


def differences(series: Series, name: str, g: Grid) -> tuple[Array, Array, Array]:
    """Return position, speed and acceleration of another joint at the stamps of a grid, [T] each.

    They are plain differences: smoothing would lose fast motion, and noise of an acceleration vanishes in the motion
    that it causes, since its double integral is the noise of the position.
    """
    own = grid(series, 1 / g.step_s, (name,))
    known = np.isfinite(own.columns[name])
    x = np.interp(own.t_s, own.t_s[known], own.columns[name][known])
    speed = np.gradient(x, own.step_s)
    acceleration = np.zeros_like(x)
    acceleration[1:-1] = np.diff(x, 2) / own.step_s**2
    position, speed, acceleration = (np.interp(g.t_s, own.t_s, each) for each in (x, speed, acceleration))
    return position, speed, acceleration


def smoothed(series: Series, name: str, g: Grid) -> tuple[Array, Array, Array]:
    """Return smoothed position, speed and acceleration of a column at the stamps of a grid, [T] each.

    For poses by motion capture, whose noise is large beside that of encoders: its double difference at a high rate
    would be larger than the motion of the body.
    """
    m = motion(grid(series, 1 / g.step_s, (name,)), name, 0.0, 0.0)
    position, speed, acceleration = (np.interp(g.t_s, m.grid.t_s, x) for x in (m.position, m.speed, m.acceleration))
    return position, speed, acceleration


def period(found: Sequence[Motion], limit: float | None = None, *, speed_alone: bool = False) -> float:
    """Return the period of the usual motion, s.

    It is that of a sine with the same travel and speed, or with the same travel and the largest acceleration `limit`
    if that is shorter, as where friction takes most of the force.
    """
    periods = []
    for m in found:
        x, v = (m.speed, np.gradient(m.speed, m.grid.step_s)) if speed_alone else (m.position, m.speed)
        swing = float(np.std(x))
        moved = swing / max(float(np.sqrt(np.mean(v**2))), 1e-12)
        pushed = moved
        if limit is not None:
            pushed = swing / limit if speed_alone else (np.sqrt(2) * swing / limit) ** 0.5
        periods.append(min(2 * np.pi * min(pushed, moved), float(m.grid.t_s[-1] - m.grid.t_s[0])))
    return max(float(np.median(periods)), 20 * found[0].grid.step_s)


def window_lengths(period_s: float, step_s: float, found: Sequence[Motion]) -> tuple[float, float]:
    """Return the length of a window, and of an independent stretch of whole windows, s."""
    trial_s = float(np.median([m.grid.t_s[-1] - m.grid.t_s[0] for m in found]))
    least = min(max(WINDOW_PERIODS * period_s, SAMPLES_LEAST * step_s), trial_s / 2)
    # A whole number of windows per standard block, or of blocks per window, because window starts affect the fit.
    window = BLOCK_S * round(least / BLOCK_S) if least > BLOCK_S else BLOCK_S / max(int(BLOCK_S / least), 1)
    wanted = min(max(BLOCK_WINDOWS * window, trial_s / STRETCHES_MOST), trial_s / STRETCHES_LEAST)
    return window, window * max(round(wanted / window), 1)


def window_edges(g: Grid, window_s: float) -> NDArray[np.int64]:
    """Return the first samples of all windows, and the end [W + 1].

    A rest of less than half a window joins the last one.
    """
    number = ((g.t_s - g.t_s[0]) / window_s + 1e-9).astype(int)
    edges = [*(part.start for part in slices(number)), len(number)]
    if len(edges) > 2 and (edges[-1] - edges[-2]) * g.step_s < 0.5 * window_s:
        del edges[-2]
    return np.array(edges)


def cut_edges(edges: NDArray[np.int64], out: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the edges of windows that also end and begin where samples are left out, since unknown forces act there.

    Args:
        edges: result of `window_edges`.
        out: whether a sample is left out, [T].
    """
    return np.union1d(edges, np.flatnonzero(np.diff(out.astype(int))) + 1)


def directions(m: Motion, edges: NDArray[np.int64], least: float) -> tuple[Array, Array]:
    """Return the sign of the motion at each window's start, 0 at rest, and that of the last motion before, [W] each.

    The axis is at rest up to the speed `least`; edges are a result of `window_edges`.
    """
    sign = np.where(np.abs(m.speed) > least, np.sign(m.speed), 0.0)
    last = np.maximum.accumulate(np.where(sign != 0.0, np.arange(len(sign)), 0))
    first = edges[:-1]
    return sign[first], sign[last[first]]


def regimes(features: Mapping[str, Array], top: float, period_s: float) -> dict[str, NDArray[np.bool_]]:
    """Return parts of the data by speed and direction, [M] masks; top: largest speed."""
    speed = features["speed"]
    still = np.abs(speed) < STILL * top
    return {
        "at rest": still,
        "moving slowly": ~still & (np.abs(speed) < SLOW * top),
        "moving fast": np.abs(speed) > 0.5 * top,
        "moving forwards": speed > STILL * top,
        "moving backwards": speed < -STILL * top,
        "after a reversal": (features["time since reversal"] < 0.1 * period_s) & ~still,
    }


def time_uncertainty(input_step_s: float) -> dict[str, float]:
    """Return the uncertainty of times, which steps of input and simulation round: 'effect.parameter' -> half-width."""
    return dict.fromkeys(("dead_time.delay", "latency.delay", "lag.time"), TIMED * input_step_s)


def within_windows(found: Sequence[Motion], edges: Sequence[NDArray[np.int64]]) -> float:
    """Return the RMS of the measured values about their mean in each window."""
    parts = [m.seen[a:b] for m, e in zip(found, edges, strict=True) for a, b in pairwise(e)]
    return float(np.sqrt(np.nanmean(np.concatenate([p - np.nanmean(p) for p in parts if np.isfinite(p).any()]) ** 2)))


def summed_twice(values: Array, edges: NDArray[np.int64], step_s: float, *, once: bool = False) -> Array:
    """Return the position (`once`: speed) since a window's start under a force of these values [T] on a unit mass."""
    out = np.empty_like(values)
    for a, b in pairwise(edges):
        speed = np.cumsum(values[a:b]) * step_s
        out[a:b] = speed if once else np.cumsum(speed) * step_s
    return out
