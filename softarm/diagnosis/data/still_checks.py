"""Checks for columns of a rig that never change: dead sensors, trials without motion, commands that are too small."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

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


class Columns:
    """Names of files and columns of a trial, for messages."""

    def __init__(self, about: Mechanism, files: Mapping[str, Path]) -> None:
        self.about, self.files = about, files

    def __call__(self, channel: str, column: str | None = None) -> str:
        """Return the file and column of a channel's column, or of its stamps if `column` is None."""
        named = self.of(channel, column)
        return f"{self.files[channel]}: column {named.source}"

    def reading(self, channel: str, column: str, value: float) -> str:
        """Return a value in the table's unit, as it is written in the table, before `add`."""
        about = self.of(channel, column)
        text = f"{(value - about.add) / factor(about.unit)[0]:.4g}"
        return text if about.unit in ("1", PURE) else f"{text} {about.unit}"

    def of(self, channel: str, column: str | None) -> Column:
        """Return a column as the stage.yaml describes it, or the time column if `column` is None."""
        known = self.about.channels[channel]
        return known.time if column is None else known.columns[column]


class Stillness(NamedTuple):
    """Finding about a channel that does not move in one trial."""

    trial: int
    kind: Literal["mistake", "left out", "warning"]
    text: str


def stillness(trials: Sequence[Trial], places: Sequence[Columns]) -> Iterator[Stillness]:
    """Yield findings about all trials of one stage; a trial without motion means little without the others."""
    moved = [{name: _spread(t.channels["measured"][name]) for name in compared_columns(t)} for t in trials]
    driven = [_driven(t) for t in trials]
    largest = {name: max(each.get(name, 0.0) for each in moved) for each in moved for name in each}
    for k, (trial, at) in enumerate(zip(trials, places, strict=True)):
        drive = driven[k]
        if drive is not None and not drive[1] and not any(moved[k].values()):
            name = next(iter(moved[k]))
            text = f"{at('measured', name)}: nothing moves in this trial, neither {name} nor {drive[0]}"
            if any(largest.values()):
                yield Stillness(k, "left out", f"{text}; it is left out")
            else:
                yield Stillness(k, "mistake", f"{text}; leave the trial out")
            continue
        for name in (name for name, spread in moved[k].items() if not spread):
            pushes = [d[1] for each, d in zip(moved, driven, strict=True) if d is not None and each.get(name)]
            small = drive is not None and pushes and drive[1] < SMALL * max(pushes)
            value = f"{name} is {at.reading('measured', name, trial.channels['measured'][name][0])} in every row"
            if small and drive is not None:
                text = f"{value}, under a small {drive[0]}; correct it if the sensor was off"
                yield Stillness(k, "warning", f"{at('measured', name)}: {text}")
            else:
                text = f"{value}; a dead sensor or the wrong column: name another, or leave this trial out"
                yield Stillness(k, "mistake", f"{at('measured', name)}: {text}")
        if drive is not None and not drive[1] and any(s > JITTER * largest[n] for n, s in moved[k].items()):
            column = next(iter(trial.channels[drive[0]].columns))
            value = at.reading(drive[0], column, trial.channels[drive[0]][column][0])
            text = f"the {drive[0]} is {value} in every row, but the measured values change"
            yield Stillness(
                k, "warning", f"{at(drive[0], column)}: {text}; correct the column, or leave this trial out"
            )
        for name, values in trial.channels["measured"].columns.items():
            if name not in moved[k] and not _spread(values):
                value = at.reading("measured", name, values[0])
                text = f"{at('measured', name)}: {name} is {value} in every row; leave the column out"
                yield Stillness(k, "warning", text)


def compared_columns(trial: Trial) -> tuple[str, ...]:
    """Return the measured columns that are compared with the model."""
    columns = trial.channels["measured"].columns
    if stage_of([trial]).kind == "tracking":
        return tuple(filter(None, [followed(columns)]))
    return tuple(name for name in columns if not name.startswith(("rate", "effort")))


def _driven(trial: Trial) -> tuple[str, float] | None:
    """Driving channel of a trial and its range, or None without one."""
    name = next((name for name in DRIVES if name in trial.channels), None)
    return None if name is None else (name, max(map(_spread, trial.channels[name].columns.values())))


def _spread(values: Array) -> float:
    """Range of a column; 0 if its values differ only in their last digits."""
    if not len(values):
        return 0.0
    spread, size = float(np.ptp(values)), float(np.max(np.abs(values)))
    return spread if spread > 1e-12 * size else 0.0
