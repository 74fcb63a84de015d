"""Checks for columns of a rig that never change: dead sensors, trials without motion, commands that are too small."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from softarm.common.quantity import PURE, factor
from softarm.diagnosis.data.stage_rules import followed
from softarm.diagnosis.data.trials import Array, Trial, stage_of
from softarm.schemas.trial import Column, Mechanism

# Channels that make a rig move.
DRIVES = ("command", "force")
# Share of the largest command that moved the rig; under a smaller one, friction may hold it.
SMALL = 0.5
# Share of the largest motion; less is a sensor's noise.
JITTER = 0.05


@dataclass(frozen=True, slots=True)
class Columns:
    """Names of files and columns of a trial, for messages."""

    about: Mechanism
    files: Mapping[str, Path]

    def __call__(self, channel: str, column: str | None = None) -> str:
        """Return the file and column of a channel's column, or of its stamps if `column` is None."""
        named = self.of(channel, column)
        return f"{self.files[channel]}: column {named.source}"

    def reading(self, channel: str, column: str, value: float) -> str:
        """Return a value as it is written in the table, before `scale` and `add`, with its unit if it has one there."""
        about = self.of(channel, column)
        text = f"{(value - about.add) / factor(about.unit)[0] / (about.scale or 1.0):.4g}"
        return text if about.unit in ("1", PURE) or about.scale != 1.0 else f"{text} {about.unit}"

    def of(self, channel: str, column: str | None) -> Column:
        """Return a column as the stage.yaml describes it, or the time column if `column` is None."""
        known = self.about.channels[channel]
        return known.time if column is None else known.columns[column]


def moving(checked: Sequence[tuple[Trial, Columns]]) -> tuple[list[Trial], list[str]]:
    """Return the trials of one stage in which something moves, with their warnings, and the mistakes.

    The trials are compared, because one without motion means little on its own.
    """
    moved = [{name: spread(t.channels["measured"][name]) for name in compared_columns(t)} for t, _ in checked]
    driven = [_driven(t) for t, _ in checked]
    largest = {name: max(each.get(name, 0.0) for each in moved) for each in moved for name in each}
    kept: list[Trial] = []
    mistakes: list[str] = []
    left_out: list[str] = []
    for (trial, at), spreads, drive in zip(checked, moved, driven, strict=True):
        measured, warnings = trial.channels["measured"], list(trial.warnings)
        if stage_of([trial]).kind == "mujoco" and not any(spreads.values()):
            name = next(iter(spreads))
            left_out.append(f"{at('measured', name)}: {name} does not move in this trial, which is left out for it")
            continue
        if drive is not None and not drive[1] and not any(spreads.values()):
            name = next(iter(spreads))
            text = f"{at('measured', name)}: nothing moves in this trial, neither {name} nor {drive[0]}"
            if any(largest.values()):
                left_out.append(f"{text}; it is left out")
            else:
                mistakes.append(f"{text}; leave the trial out")
            continue
        for name in (name for name, extent in spreads.items() if not extent):
            pushes = [d[1] for each, d in zip(moved, driven, strict=True) if d is not None and each.get(name)]
            value = f"{name} is {at.reading('measured', name, measured[name][0])} in every row"
            if drive is not None and pushes and drive[1] < SMALL * max(pushes):
                text = f"{value}, under a small {drive[0]}; correct it if the sensor was off"
                warnings.append(f"{at('measured', name)}: {text}")
            else:
                text = f"{value}; a dead sensor or the wrong column: name another, or leave this trial out"
                mistakes.append(f"{at('measured', name)}: {text}")
        if drive is not None and not drive[1] and any(s > JITTER * largest[n] for n, s in spreads.items()):
            column = next(iter(trial.channels[drive[0]].columns))
            value = at.reading(drive[0], column, trial.channels[drive[0]][column][0])
            text = f"the {drive[0]} is {value} in every row, but the measured values change"
            warnings.append(f"{at(drive[0], column)}: {text}; correct the column, or leave this trial out")
        for name, values in measured.columns.items():
            if name not in spreads and not spread(values):
                value = at.reading("measured", name, values[0])
                warnings.append(f"{at('measured', name)}: {name} is {value} in every row; leave the column out")
        kept.append(replace(trial, warnings=tuple(warnings)))
    if kept and left_out:
        kept[0] = replace(kept[0], warnings=(*kept[0].warnings, *left_out))
    return kept, mistakes


def compared_columns(trial: Trial) -> tuple[str, ...]:
    """Return the measured columns that are compared with the model."""
    columns = trial.channels["measured"].columns
    stage = stage_of([trial])
    if stage.kind == "tracking":
        return tuple(filter(None, [followed(columns)]))
    if stage.kind == "mujoco":
        return (stage.name,)
    return tuple(name for name in columns if not name.startswith(("rate", "effort")))


def _driven(trial: Trial) -> tuple[str, float] | None:
    """Driving channel of a trial and its range, or None without one."""
    name = next((name for name in DRIVES if name in trial.channels), None)
    return None if name is None else (name, max(map(spread, trial.channels[name].columns.values())))


def spread(values: Array) -> float:
    """Return the range of a column; 0 if its values differ only in their last digits."""
    if not len(values):
        return 0.0
    extent, size = float(np.ptp(values)), float(np.max(np.abs(values)))
    return extent if extent > 1e-12 * size else 0.0
