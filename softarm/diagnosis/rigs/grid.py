"""Trials of a rig on uniform stamps, averaged down to the rate that a fit needs, and cut into windows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from softarm.diagnosis.data.trials import Array, Series, Trial, TrialError

RATE_MAX_HZ = 200.0
# Least number of levels that show an encoder's step, and the rounding allowed in each, in steps.
LEVELS_LEAST, ROUNDED = 10, 0.2
# Nothing is compared within gaps longer than this: in seconds or samples of the source, and in steps of the grid.
GAP_S, GAP_SAMPLES, GAP_STEPS = 0.1, 50, 5


@dataclass(frozen=True, slots=True)
class Grid:
    """Measured columns of one trial on uniform stamps."""

    t_s: Array  # [T]
    step_s: float
    columns: Mapping[str, Array]  # [T]; NaN in gaps


def grid(series: Series, rate_max_hz: float = RATE_MAX_HZ, columns: Sequence[str] | None = None) -> Grid:
    """Resample columns of a channel, all by default, to uniform stamps.

    A source that is faster than `rate_max_hz` is averaged in bins, which also filters aliases; a slow source is
    interpolated linearly. Raises TrialError if the channel has fewer than 20 samples.
    """
    if len(series) < 20:
        raise TrialError(f"a channel has {len(series)} samples, a fit needs at least 20; leave this trial out")
    t, names = series.t_s, tuple(series.columns) if columns is None else tuple(columns)
    usual = float(np.median(np.diff(t)))
    bins = max(1, round(1 / (usual * rate_max_hz)))
    step = usual * bins
    if bins == 1:
        step = float(t[-1] - t[0]) / max(1, round(float(t[-1] - t[0]) / usual))
        at = t[0] + step * np.arange(round(float(t[-1] - t[0]) / step) + 1)
        found = {name: np.interp(at, t, series[name]) for name in names}
    else:
        # Means of interpolated values, not of the samples in a bin: samples whose stamps jitter across a bin's edge
        # would shift a fast signal by half a sample.
        at = t[0] + step * (np.arange(int((float(t[-1] - t[0]) / usual + 1.5) / bins)) + 0.5) - 0.5 * usual
        places = at[:, None] + usual * (np.arange(bins) - 0.5 * (bins - 1))
        found = {name: np.interp(places, t, series[name]).mean(axis=1) for name in names}
    longest = max(GAP_STEPS * step, min(GAP_S, GAP_SAMPLES * usual))
    return Grid(at, step, {name: _without_gaps(at, t, values, longest) for name, values in found.items()})


def held_integral(series: Series, values: Array, margin_s: float) -> tuple[Array, Array]:
    """Return stamps and the integral of values that are held between stamps, extended by a margin at both ends."""
    t = np.concatenate(([series.t_s[0] - margin_s], series.t_s, [series.t_s[-1] + margin_s]))
    held = np.concatenate(([values[0]], values))
    return t, np.concatenate(([0.0], np.cumsum(held * np.diff(t))))


def held_means(integral: tuple[Array, Array], start_s: float, step_s: float, count: int) -> Array:
    """Return the means of held values over steps, [count]; integral: result of `held_integral`.

    The first step's start may be any fraction of a sample.
    """
    return np.asarray(np.diff(np.interp(start_s + step_s * np.arange(count + 1), *integral)) / step_s)


def usual_step(integrals: Sequence[tuple[Array, Array]]) -> float:
    """Return the usual time between two inputs, s, of the slowest trial; integrals: results of `held_integral`."""
    return max(float(np.median(np.diff(t))) for t, _ in integrals)


def fastest_change(integrals: Sequence[tuple[Array, Array]]) -> float:
    """Return the fastest change of any input per second; 0 without an input; integrals: results of `held_integral`."""
    rates = []
    for t_s, summed in integrals:
        held = np.diff(summed) / np.diff(t_s)
        rates.append(float(np.max(np.abs(np.diff(held))) / np.median(np.diff(t_s))))
    return max(rates, default=0.0)


def time_since_change(t_s: Array, values: Array) -> Array:
    """Return the time since a value last changed, s [T]."""
    changed = np.concatenate(([0], np.flatnonzero(np.diff(values)) + 1))
    return np.asarray(t_s - t_s[changed[np.searchsorted(changed, np.arange(len(t_s)), side="right") - 1]])


def _without_gaps(at: Array, t: Array, values: Array, longest_s: float) -> Array:
    """Set values to NaN within long gaps of the source."""
    values = values.copy()
    for k in np.flatnonzero(np.diff(t) > longest_s):
        values[(at > t[k]) & (at < t[k + 1])] = np.nan
    return values


def resolution(signals: Sequence[Array]) -> float:
    """Return an encoder's step, of which all differences are whole multiples within rounding; 0 if there is none."""
    values = np.concatenate(signals)
    levels = np.unique(values[np.isfinite(values)])
    if len(levels) < LEVELS_LEAST:
        return 0.0
    apart = np.diff(levels)
    apart = np.sort(apart[apart > 1e-9 * (levels[-1] - levels[0])])
    if len(apart) < LEVELS_LEAST:
        return 0.0
    near = apart[: max(LEVELS_LEAST, len(apart) // 4)]
    step = float(np.median(near[near < 1.5 * near[0]]))
    whole = np.abs(near / step - np.round(near / step)) < ROUNDED
    return step if np.mean(whole) > 0.9 else 0.0


def windows(trial: Trial, seconds: float) -> tuple[Trial, ...]:
    """Cut a trial into equal windows of about this length; each is a trial with its stamps and the whole input."""
    series = trial.channels["measured"]
    start, end = float(series.t_s[0]), float(series.t_s[-1])
    count = max(1, round((end - start) / seconds))
    if count == 1:
        return (trial,)
    edges = (*np.linspace(start, end, count + 1)[:-1], np.inf)
    return tuple(
        replace(
            trial,
            name=f"{trial.name} from {low - start:.4g} s",
            recording=trial.recording or trial.name,
            channels={**trial.channels, "measured": series.kept((series.t_s >= low) & (series.t_s < high))},
        )
        for low, high in pairwise(edges)
    )
