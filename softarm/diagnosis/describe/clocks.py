"""Time columns of a rig's recordings: their unit, rate and gaps, and which column leads another."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from softarm.common.quantity import factor
from softarm.diagnosis.data import checks, table_files
from softarm.diagnosis.data.table_checks import STEP_LIKELY_S, STEP_MIN_S, time_unit
from softarm.diagnosis.data.trials import Array, TrialError
from softarm.diagnosis.describe.survey import Signal, Survey, common_start

# Share of a clock's steps that do not fall; a few rows may be out of order.
RISING = 0.9
# Share of the usual step that regular steps may differ by.
REGULAR = 0.05
# Rows that a correlation is computed of, and the share of the recording that a lag may have.
POINTS, LAG_SHARE = 4096, 0.2
# At this number the nanoseconds of a stamp in two columns start again.
SECOND_NS = 1e9


@dataclass(frozen=True, slots=True)
class Clock:
    """Stamps of a group of columns."""

    source: str | int
    unit: str
    scale: float
    times_s: tuple[Array, ...]  # of each recording
    note: str
    signal: Signal | None  # None where the rows are counted


def candidates(survey: Survey, group: int) -> list[Signal]:
    """Return the columns of a group that may be its time, the likeliest first."""
    own = [s for s in survey.signals if s.group == group and not s.elements and _rises(s)]
    named = [s for s in own if s.header.role == "time" or s.dates]
    return named or [s for s in own if not s.header.role and not s.header.unit and _is_regular(s)][:1]


def of(signal: Signal, times: Sequence[Signal], units: Mapping[str, str], rate_hz: float | None) -> Clock:
    """Return the clock of a signal; its unit is empty if it is unknown.

    Args:
        signal: the column whose stamps are wanted.
        times: candidates for its time column; without one its rows are counted.
        units: label of a column -> its unit, where the user has given it.
        rate_hz: rows a second, where rows are counted.

    Raises:
        TrialError: the time does not rise.
    """
    if not times:
        assert rate_hz is not None, "rows without stamps have a rate"
        step = 1 / rate_hz
        stamps = tuple(np.asarray(np.arange(len(each)) * step) for each in signal.values)
        return Clock(table_files.ROWS, "s", float(f"{step:.9g}"), stamps, f"{rate_hz:g} rows a second, as given", None)
    time = _nearest(times, signal)
    steps = np.concatenate([np.diff(each) for each in time.values])
    steps = steps[np.isfinite(steps)]
    step = float(np.median(steps)) if len(steps) else 0.0
    if not step > 0 or np.mean(steps >= 0) < RISING:
        raise TrialError(f"--time {time.label}: its numbers do not rise; name the column that holds the time")
    unit, origin = time.header.unit, "unit from the header"
    if time.label in units:
        unit, origin = units[time.label], "unit as given"
    if time.dates:
        unit, origin = "s", "dates"
    elif unit is None:
        unit, origin = "s" if STEP_MIN_S <= step <= STEP_LIKELY_S[1] else time_unit(step), "unit from the step"
        origin += "; if it counts rows, write `scale` with the seconds per row" if step == 1.0 else ""
    worth = factor(unit or "s")[0]
    stamps = tuple(np.asarray(each * worth) for each in time.values)
    note = f"{1 / (step * worth):.4g} rows a second"
    note += f", {count} gaps" if (count := _gaps(stamps, step * worth)) else ""
    others = [each.label for each in times if each.group == time.group and each is not time]
    note += f"; {origin}" + (f"; or {', '.join(others)}" if others else "")
    return Clock(time.source, unit or "", 1.0, stamps, note, time)


def _gaps(stamps: Sequence[Array], step_s: float) -> int:
    """Return the number of gaps that the diagnosis reports as dropouts."""
    long = max(checks.GAP_FACTOR * step_s, checks.GAP_MIN_S)
    return sum(int(np.sum(np.diff(each[np.isfinite(each)]) > long)) for each in stamps)


def _nearest(times: Sequence[Signal], signal: Signal) -> Signal:
    """Time column whose name has most in common with a signal's: `Theta1.time` for `Theta1.signals`."""
    same = [each for each in times if [len(v) for v in each.values] == [len(v) for v in signal.values]] or times
    return max(same, key=lambda each: len(common_start((str(each.source), str(signal.source)))))


def lead(one: Signal, other: Signal, clocks: Mapping[int, Clock]) -> tuple[float, float]:
    """Return the time by which one signal leads another, s, and their correlation at that lag, -1 to 1."""
    known = (np.isfinite(x).sum() * np.isfinite(y).any() for x, y in zip(one.values, other.values, strict=True))
    longest = int(np.argmax([*known]))
    t, s = clocks[one.group].times_s[longest], clocks[other.group].times_s[longest]
    low, high = max(np.nanmin(t), np.nanmin(s)), min(np.nanmax(t), np.nanmax(s))
    at = np.linspace(low, high, POINTS)
    x, y = (_resampled(at, stamps, signal.values[longest]) for stamps, signal in ((t, one), (s, other)))
    size = float(np.sqrt((x @ x) * (y @ y)))
    if size == 0 or high <= low:
        return 0.0, 0.0
    full = np.fft.irfft(np.conj(np.fft.rfft(x, 2 * POINTS)) * np.fft.rfft(y, 2 * POINTS))
    most = int(LAG_SHARE * POINTS)
    lags = np.concatenate([np.arange(most), np.arange(-most, 0)])
    best = int(lags[np.argmax(np.abs(full[lags]))])
    return best * float(at[1] - at[0]), float(full[best] / size)


def _resampled(at: Array, stamps: Array, values: Array) -> Array:
    good = np.isfinite(stamps) & np.isfinite(values)
    found = np.interp(at, stamps[good], values[good])
    return np.asarray(found - found.mean())


def _rises(signal: Signal) -> bool:
    steps = np.concatenate([np.diff(each[np.isfinite(each)]) for each in signal.values])
    if len(steps) and steps.min() < -SECOND_NS / 2 and signal.all.max() < SECOND_NS:
        return False
    return bool(len(steps) and np.mean(steps >= 0) > 0.99 and np.mean(steps > 0) > 0.5)


def _is_regular(signal: Signal) -> bool:
    steps = np.concatenate([np.diff(each) for each in signal.values])
    usual = float(np.median(steps))
    is_counter = usual == 1.0
    return bool(usual > 0 and not is_counter and np.mean(np.abs(steps / usual - 1) < REGULAR) > 0.9)
