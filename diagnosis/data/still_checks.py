"""Columns of a rig that never change: a dead sensor, a trial in which nothing happens, or one too small to move it."""

from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple, Protocol

import numpy as np

from softarm.diagnosis.data.stage_rules import followed
from softarm.diagnosis.data.trials import Array, Trial

DRIVES = ("command", "force")  # what makes a rig move, where something does
SMALL = 0.5  # of the largest drive that moved it: what stands still at less may be held by friction
JITTER = 0.05  # of the largest motion: less is a sensor's noise


class Where(Protocol):
    """Where a trial's columns come from."""

    def __call__(self, channel: str, column: str) -> str:
        """File and column."""

    def reading(self, channel: str, column: str, value: float) -> str:
        """A number of the trial's, as it stands in the owner's column."""


class Stillness(NamedTuple):
    """What is so of one trial of a stage."""

    trial: int
    so: Literal["wrong", "left out", "odd"]
    text: str


def stillness(trials: Sequence[Trial], places: Sequence[Where]) -> Iterator[Stillness]:
    """Look at all trials of one stage: what stands still in one says little without the others."""
    moved = [{name: _spread(t.channels["measured"][name]) for name in judged(t)} for t in trials]
    driven = [_driven(t) for t in trials]
    largest = {name: max(each.get(name, 0.0) for each in moved) for each in moved for name in each}
    for k, (trial, at) in enumerate(zip(trials, places, strict=True)):
        drive = driven[k]
        if drive is not None and not drive[1] and not any(moved[k].values()):
            yield _nothing(k, trial, at, drive[0], others=any(largest.values()))
            continue
        for name in (name for name, spread in moved[k].items() if not spread):
            pushes = [d[1] for each, d in zip(moved, driven, strict=True) if d is not None and each.get(name)]
            small = drive is not None and pushes and drive[1] < SMALL * max(pushes)
            value = f"{name} is {at.reading('measured', name, trial.channels['measured'][name][0])} in every row"
            if small and drive is not None:
                yield Stillness(k, "odd", f"{at('measured', name)}: {value}, under a small {drive[0]}; correct it if "
                                          "the sensor was off")  # fmt: skip
            else:
                yield Stillness(k, "wrong", f"{at('measured', name)}: {value}; a dead sensor or the wrong column: name "
                                            "another, or leave this trial out")  # fmt: skip
        if drive is not None and not drive[1] and any(s > JITTER * largest[n] for n, s in moved[k].items()):
            column = next(iter(trial.channels[drive[0]].columns))
            value = at.reading(drive[0], column, trial.channels[drive[0]][column][0])
            yield Stillness(
                k,
                "odd",
                f"{at(drive[0], column)}: the {drive[0]} is {value} in every row "
                "while what is measured moves; is it the right column? leave the trial out, if it is not",
            )
        for name, values in trial.channels["measured"].columns.items():
            if name not in moved[k] and not _spread(values):
                value = at.reading("measured", name, values[0])
                text = f"{at('measured', name)}: {name} is {value} in every row; leave the column out"
                yield Stillness(k, "odd", text)


def judged(trial: Trial) -> tuple[str, ...]:
    """Measured columns that a stage is judged by."""
    columns = trial.channels["measured"].columns if "measured" in trial.channels else {}
    kind = trial.stage.kind if trial.stage is not None else ""
    if kind == "tracking":
        return tuple(filter(None, [followed(columns)]))
    return tuple(name for name in columns if not name.startswith(("rate", "effort")))


def _nothing(k: int, trial: Trial, at: Where, drive: str, others: bool) -> Stillness:
    name = judged(trial)[0]
    text = f"{at('measured', name)}: nothing moves in this trial, neither {name} nor {drive}"
    return (
        Stillness(k, "left out", f"{text}; it is left out")
        if others
        else Stillness(k, "wrong", f"{text}; leave the trial out")
    )


def _driven(trial: Trial) -> tuple[str, float] | None:
    """What drives a trial, and how far it goes; None where nothing does."""
    name = next((name for name in DRIVES if name in trial.channels), None)
    return None if name is None else (name, max(map(_spread, trial.channels[name].columns.values())))


def _spread(values: Array) -> float:
    """How far a column goes; 0 for one that only differs in the last digits of its numbers."""
    if not len(values):
        return 0.0
    spread, size = float(np.ptp(values)), float(np.max(np.abs(values)))
    return spread if spread > 1e-12 * size else 0.0
