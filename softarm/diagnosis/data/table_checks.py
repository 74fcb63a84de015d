"""Checks of a rig's table against its stage.yaml before a fit: clocks, units, ranges.

Data that cannot be diagnosed are rejected; doubtful data give a warning. Either message is one sentence that names
file, column and next step.
"""

from collections.abc import Callable, Iterator
from itertools import combinations

import numpy as np

from softarm.common.quantity import PURE, UNITS, factor
from softarm.diagnosis.data import checks
from softarm.diagnosis.data.still_checks import Columns, compared_columns
from softarm.diagnosis.data.trials import Array, Series, TableStage, TableUnit, Trial, TrialError, stage_of
from softarm.schemas.stage_model import StageKind
from softarm.schemas.trial import Column, TableChannel

# Least number of rows and seconds of the measured channel.
ROWS_LEAST, SECONDS_LEAST = 20, 0.8
# Usual steps between rows outside these bounds mean that the stamps have another unit.
STEP_MIN_S, STEP_SLOW_S, STEP_MAX_S = 4e-5, 0.5, 2.0
STEP_LIKELY_S = (2e-4, 0.2)
# A step back by more usual steps than this means that the clock was set; a smaller one is a delayed row.
BACK_STEPS = 5.0
# With more steps back than this, rows are out of order and can be sorted.
SETS_MOST = 3
# Ratios of two clocks of one recording whose units differ.
SPANS = (1e3, 1e6, 1e9)
# Data before the first and after the last command that are allowed.
LATE_S, LATE_SHARE = 1.0, 0.05
# Relative tolerance of a ratio that is taken for that of two units.
ALIKE = 0.08
# Ratio of measured to commanded range that no effect explains, and that certainly no lag explains.
SWING_RATIO = 4.0
SWING_SURE = 50.0
# Time over which slopes are compared, and relative difference that is allowed.
SLOPE_S, SLOPE_TOLERANCE = 0.08, 0.3
# A step this close to a whole turn is a wrapped angle.
WRAP_RAD = 0.3
UPRIGHT_RAD = 0.5
# Interval at which a mass's speed is compared, and acceleration that an incline may add.
PUSH_S, WEIGHT_M_S2 = 0.1, 10.0

# Maps a row's index to its number in the file.
Place = Callable[[int], int]


def clock(time_s: Array, about: Column, where: str, place: Place, on_change: bool) -> list[str]:
    """Return warnings about the stamps of a channel.

    For messages, `where` is file and column and `place` maps a row's index to its number in the file. With on_change,
    rows may be logged only when the value changes, as commands may. Raises TrialError if the column cannot be a clock.
    """
    steps = np.diff(time_s)
    if not steps.size:
        return []
    if not steps.any():
        raise TrialError(f"{where}: every row has the stamp {time_s[0]:g} s; name the column that holds the time")
    usual = float(np.median(np.abs(steps)))
    seconds = factor(about.unit)[0] * about.scale
    back = np.flatnonzero(steps < -max(BACK_STEPS * usual, 1e-9))
    if 0 < back.size <= SETS_MOST:
        k = int(back[0])
        raise TrialError(
            f"{where}: the clock is set back by {-steps[k]:.4g} s at row {place(k + 1)} ({time_s[k]:.6g} s, then "
            f"{time_s[k + 1]:.6g} s); split the recording there into two trials"
        )
    if usual and not STEP_MIN_S <= usual <= (np.inf if on_change else STEP_MAX_S):
        likely = time_unit(usual / seconds)
        raise TrialError(
            f"{where}: rows are {usual:.4g} s apart"
            + (f"; its stamps look like {likely}: write `unit: {likely}`" if likely else "; correct its `unit`")
        )
    ahead = np.flatnonzero(steps > checks.SPLIT_S)
    if ahead.size and usual < 1.0 and not on_change:
        k = int(ahead[0])
        raise TrialError(
            f"{where}: the clock jumps ahead by {steps[k]:.4g} s at row {place(k + 1)}; split the recording "
            f"there into two trials: in the first write `to_s: {time_s[k] - time_s[0]:.4g}`, in the second `from_s`"
        )
    if usual < STEP_SLOW_S or on_change:
        return []
    return [
        f"{where}: rows are {usual:.4g} s apart; if its stamps are in ms, write `unit: ms`; if they count rows, write "
        "`scale` with the seconds per row"
    ]


def time_unit(step: float) -> str | None:
    """Return the unit in which a step is one that rigs are usually recorded with."""
    units = {"s": 1.0, **UNITS["s"]}
    low, high = STEP_LIKELY_S
    return next((unit for unit, factor_ in units.items() if low <= step * factor_ <= high), None)


def ranges(series: Series, kind: StageKind, channel: TableChannel, where: str) -> Iterator[str]:
    """Yield warnings about columns whose range is implausible in the unit that the stage.yaml names."""
    limits = {"m": (20.0, "millimetres"), "kPa": (2000.0, "Pa"), "m/s": (50.0, "mm/s")}
    if kind != "driven_mass":  # a wheel turns for long
        limits["rad"] = (13.0, "degrees")
    for name, column in channel.columns.items():
        of_one, unit = factor(column.unit)
        top = float(np.max(np.abs(series[name] - column.add), initial=0.0))
        if unit in limits and top > limits[unit][0] and of_one <= 1.0:  # a larger unit such as bar or rev is no slip
            standard = f", {top:.4g} {unit}" if column.unit != unit else ""
            yield (
                f"{where}: {name} goes up to {top / of_one:.4g} {column.unit}{standard} (from {column.source}); "
                f"is it in {limits[unit][1]}? correct `unit` in the stage.yaml"
            )


def judge(trial: Trial, at: Columns) -> tuple[list[str], list[str]]:
    """Return the reasons why a trial cannot be diagnosed; without any, the warnings about it."""
    stage = stage_of([trial])
    doubts = [*_slips(trial, stage, at), *_slopes(trial, stage, at)]
    slips = [text for sure, text in doubts if sure]
    mistakes = [
        *_too_short(trial, at),
        *_apart(trial, at),
        *_wrapped(trial, stage, at),
        *(slips or _pushed(trial, stage, at)),
    ]
    if mistakes:
        return mistakes, []
    return [], [*(text for sure, text in doubts if not sure), *_late(trial, at), *_upright(trial, stage, at)]


def _too_short(trial: Trial, at: Columns) -> Iterator[str]:
    for name, series in trial.channels.items():
        t = series.t_s
        length = float(t[-1] - t[0]) if len(t) else 0.0
        needed = (ROWS_LEAST, SECONDS_LEAST) if name == "measured" else (2, 0.0)
        if len(t) < needed[0] or length < needed[1]:
            yield (
                f"{at(name)}: {len(t)} rows over {length:.3g} s; the {name} channel needs {needed[0]} rows over "
                f"{needed[1]:g} s at least: record longer, leave this trial out, or correct the time's `unit`"
            )


def _apart(trial: Trial, at: Columns) -> Iterator[str]:
    """Channels whose clocks have different units, or do not overlap."""
    spans = {name: (float(s.t_s[0]), float(s.t_s[-1])) for name, s in trial.channels.items() if len(s) > 1}
    for one, other in combinations(spans, 2):
        (a, b), (c, d) = spans[one], spans[other]
        ratio = (b - a) / (d - c)
        many = min(len(trial.channels[one]), len(trial.channels[other])) >= ROWS_LEAST
        if many and any(abs(max(ratio, 1 / ratio) / span - 1) < 0.2 for span in SPANS):
            yield (
                f"{at(one)}: the {one} channel lasts {b - a:.4g} s, {other} {d - c:.4g} s; "
                "the stamps of one have another unit: correct its `unit`"
            )
        elif min(b, d) <= max(a, c):
            yield (
                f"{at(one)}: the {one} channel runs from {a:.6g} to {b:.6g} s, {other} from {c:.6g} to {d:.6g} s: they "
                "do not overlap; stamp both by one clock"
            )


def _late(trial: Trial, at: Columns) -> Iterator[str]:
    """Measured rows after the last command, or before the first one."""
    drive = next((name for name in ("command", "force", "torque") if name in trial.channels), None)
    if drive is None:
        return
    sent, seen = trial.channels[drive].t_s, trial.channels["measured"].t_s
    allowed = max(LATE_S, LATE_SHARE * float(seen[-1] - seen[0]))
    if seen[-1] - sent[-1] > allowed:
        yield (
            f"{at('measured')}: goes on for {seen[-1] - sent[-1]:.3g} s after the last {drive}, which counts as held; "
            "cut those rows, or log it to the end"
        )
    if sent[0] - seen[0] > allowed:
        yield (
            f"{at('measured')}: begins {sent[0] - seen[0]:.3g} s before the first {drive}, which counts as held; cut "
            "those rows, or log it from the start"
        )


def _wrapped(trial: Trial, stage: TableStage, at: Columns) -> Iterator[str]:
    """Angles that start again after a whole turn."""
    for name, values in trial.channels["measured"].columns.items():
        if stage.unit("measured", name) != "rad" or len(values) < ROWS_LEAST:
            continue
        steps = np.abs(np.diff(values))
        turns = np.flatnonzero(np.abs(steps - 2 * np.pi) < WRAP_RAD)
        if turns.size and float(np.quantile(steps, 0.9)) < WRAP_RAD:
            yield (
                f"{at('measured', name)}: {name} starts again after a whole turn at "
                f"{trial.channels['measured'].t_s[turns[0]]:.4g} s; write it without wrapping (numpy.unwrap)"
            )


def _slips(trial: Trial, stage: TableStage, at: Columns) -> Iterator[tuple[bool, str]]:
    """Ranges of command and measured value that do not match: (whether a unit is certainly wrong, sentence)."""
    if stage.kind != "tracking":
        return
    (name,) = compared_columns(trial)
    seen, expected = trial.channels["measured"][name], stage.reached(trial.channels["command"]["command"])
    spread = [float(np.quantile(x, 0.95) - np.quantile(x, 0.05)) for x in (seen, expected)]
    if min(spread) <= 0:
        return
    ratio = spread[0] / spread[1]
    if 1 / SWING_RATIO < ratio < SWING_RATIO:
        return
    text = (
        f"{at('measured', name)}: {name} moves {ratio:.3g} times as far as the model predicts for its command "
        f"({at('command', 'command')})"
    )
    measured, command = stage.units["measured"][name], stage.units["command"]["command"]
    likely = _likely((measured, 1 / ratio, name), (command, ratio, "command"))
    levels = [float(np.mean(x)) for x in (seen, expected)]
    same_level = levels[1] and abs(levels[1]) > 0.3 * spread[1]
    slipped = abs(levels[0] / levels[1] / ratio - 1) < 2 * ALIKE if same_level else ratio < 1 / SWING_SURE
    if likely:
        yield (ratio > 1 or slipped), f"{text}; {likely}: correct `unit`, or write `gain` in the model"
    else:
        yield ratio > SWING_SURE or ratio < 1 / SWING_SURE, f"{text}; correct a `unit`, or write `gain` in the model"


def _pushed(trial: Trial, stage: TableStage, at: Columns) -> Iterator[str]:
    """A mass whose speed changes by far more than its force and weight allow."""
    if stage.kind != "driven_mass":
        return
    force, measured = trial.channels["force"], trial.channels["measured"]
    driver, place = next(iter(force.columns)), next(iter(measured.columns))
    if min(len(force), len(measured)) < ROWS_LEAST:
        return
    gain, offset = stage.number("gain", 1.0), stage.number("offset", 0.0)
    mass = stage.number("inertia_kg_m2", stage.number("mass_kg", 1.0))
    t = np.arange(measured.t_s[0], measured.t_s[-1], PUSH_S)
    x = np.interp(t, measured.t_s, measured[place])
    jumps = np.diff(x, 1 if place == "velocity" else 2) / (1.0 if place == "velocity" else PUSH_S)
    most = (abs(gain) * float(np.max(np.abs(force[driver]))) + abs(offset)) / mass + WEIGHT_M_S2
    seen = float(np.quantile(np.abs(jumps), 0.9)) / PUSH_S if len(jumps) else 0.0
    if seen > SWING_SURE * most:
        yield (
            f"{at('measured', place)}: {place} accelerates by {seen:.3g} (in m/s^2 or rad/s^2), but {driver} "
            f"({at('force', driver)}) and the model's mass allow {most:.3g}; correct a `unit`, `gain` or the mass"
        )


def _likely(*columns: tuple[TableUnit, float, str]) -> str:
    """Name the unit that each column (declared unit, ratio to the true unit, name) seems to have; maybe empty."""
    found = []
    for declared, ratio, name in columns:
        own = {declared.standard: 1.0, **UNITS.get(declared.standard, {})}
        known = own if declared.standard != PURE else {"%": 0.01, "1": 1.0}
        alike = [unit for unit, each in known.items() if abs(declared.factor * ratio / each - 1) < ALIKE]
        found += [f"{name} looks like {min(alike, key=len)}"] if alike else []
    return " or ".join(found)


def _slopes(trial: Trial, stage: TableStage, at: Columns) -> Iterator[tuple[bool, str]]:
    """Rates that are not the slopes of their positions; of a tracking stage only the position is used."""
    measured = trial.channels["measured"]
    if len(measured) < ROWS_LEAST:
        return
    pairs = [("position", "velocity"), *((f"angle{i}", f"rate{i}") for i in range(1, 13))]
    for place, rate in pairs:
        if not {place, rate} <= measured.columns.keys():
            continue
        ratio = _slope_ratio(measured.t_s, measured[place], measured[rate])
        # `still_checks` reports a rate that is zero in every row.
        if not ratio or abs(ratio - 1) <= SLOPE_TOLERANCE:
            continue
        units = stage.units["measured"]
        likely = (
            "one of the two has the opposite sign"
            if abs(ratio + 1) <= SLOPE_TOLERANCE
            else _likely((units[place], ratio, place), (units[rate], 1 / ratio, rate))
        )
        yield (
            bool(likely) and stage.kind != "tracking",
            f"{at('measured', rate)}: {rate} is {ratio:.3g} times the slope of {place} ({at('measured', place)}); "
            + (f"{likely}: " if likely else "")
            + "correct `unit` or `scale` of one",
        )


def _slope_ratio(t: Array, x: Array, v: Array) -> float | None:
    """Ratio of a rate to its position's slope, over times in which a sensor's resolution does not matter."""
    wide = max(1, round(SLOPE_S / max(float(np.median(np.diff(t))), 1e-9)))
    if len(t) <= 2 * wide:
        return None
    summed = np.concatenate(([0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t))))
    moved, integrated = x[wide:] - x[:-wide], summed[wide:] - summed[:-wide]
    return float(moved @ integrated / (moved @ moved)) if moved @ moved > 0 else None


def _upright(trial: Trial, stage: TableStage, at: Columns) -> Iterator[str]:
    """A pendulum whose angle is not zero when it hangs."""
    for name in compared_columns(trial) if stage.kind == "pendulum" else ():
        middle = float(np.median(trial.channels["measured"][name]))
        if shift := upright_shift(middle):
            yield (
                f"{at('measured', name)}: the median of {name} is {middle:.3g} rad, but a pendulum hangs at 0; "
                f"write `add: {shift:.6f}`"
            )


def upright_shift(median_rad: float) -> float:
    """Return the half turn that brings the median of an angle to 0, or 0.0 if the median is not near a half turn."""
    return float(-np.copysign(np.pi, median_rad)) if abs(abs(median_rad) - np.pi) < UPRIGHT_RAD else 0.0
