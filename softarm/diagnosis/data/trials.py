"""In-memory form of a recording, independent of its source (docs/reference/trials.md)."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from softarm.schemas.policy import OBSERVATION
from softarm.schemas.stage_model import ModelValue, StageKind

Array = NDArray[np.float64]

LINKS = 5


def mocap_columns(links: int = LINKS) -> dict[str, str]:
    """Column -> unit of the mocap channel; linkN is the marker set at the far end of link N."""
    bodies = ("cart", *(f"link{i}" for i in range(1, links + 1)))
    poses = {f"{body}_{part}": unit for body in bodies for part, unit in (("y", "m"), ("z", "m"), ("angle", "rad"))}
    return {"t_receive": "s", **poses}


# Channel -> column -> unit of a recording of the robot; every channel has stamps of its own.
ROBOT_CHANNELS: dict[str, dict[str, str]] = {
    "command": {"cart_velocity": "m/s", "pressure": "kPa"},  # as sent, piecewise constant
    "pressure": {"pressure": "kPa"},  # the regulator's own sensor
    "rail": {"position": "m", "velocity": "m/s"},  # the axis's own read-back
    "mocap": mocap_columns(),
    "observation": {signal.name: signal.unit for signal in OBSERVATION},
}
# Stage -> channels that it needs to be observable.
STAGE_NEEDS: dict[str, tuple[str, ...]] = {
    "pressure": ("command", "pressure"),
    "rail": ("command", "rail"),
    "arm": ("pressure", "mocap"),
    "mocap": ("mocap", "rail"),
    "observation": ("observation", "mocap"),
    "clock": ("command",),
}


class TrialError(Exception):
    """Invalid trial; the message names file, column and row if there is one, and the next step."""


@dataclass(frozen=True, slots=True)
class Series:
    """Columns of samples that share their stamps."""

    t_s: Array  # [N] measured stamps, strictly increasing; of mocap: capture stamps
    columns: Mapping[str, Array]  # each [N]; NaN where a marker was not tracked

    def __post_init__(self) -> None:
        for values in (self.t_s, *self.columns.values()):
            values.flags.writeable = False  # one trial serves many fits

    def __getitem__(self, column: str) -> Array:
        return self.columns[column]

    def __len__(self) -> int:
        return len(self.t_s)

    def kept(self, keep: NDArray[np.bool_]) -> "Series":
        """Return the rows that are kept."""
        return Series(self.t_s[keep], {name: values[keep] for name, values in self.columns.items()})


class TableUnit(NamedTuple):
    """Unit of a table's column."""

    name: str  # as written in the stage.yaml
    factor: float  # number of standard units in one
    standard: str  # the unit of the Series


@dataclass(frozen=True, slots=True)
class TableStage:
    """Mechanism of a rig, as its stage.yaml describes it."""

    name: str
    kind: StageKind
    model: Mapping[str, ModelValue]  # nominal parameters in standard units: `softarm.schemas.stage_model`
    units: Mapping[str, Mapping[str, TableUnit]] = field(default_factory=dict)  # channel -> column -> unit
    relative: bool = False  # whether a chain's angles were measured from link to link; here they are absolute
    # Effect -> parameter -> value of the nominal model, in the units of a verdict.
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def number(self, key: str, default: float) -> float:
        """Return a parameter of the model, its first value if it has several, or the default."""
        return float(np.ravel(np.asarray(self.model.get(key, default), dtype=float))[0])

    def reached(self, command: Array) -> Array:
        """Return the final value under constant commands: by `map`, extrapolated, or by `gain` and `offset`."""
        if "map" not in self.model:
            return np.asarray(command * self.number("gain", 1.0) + self.number("offset", 0.0))
        at, values = np.asarray(self.model["map"], dtype=float).T
        slopes = np.diff(values) / np.diff(at)
        below, above = np.minimum(command - at[0], 0.0), np.maximum(command - at[-1], 0.0)
        return np.asarray(np.interp(command, at, values) + slopes[0] * below + slopes[-1] * above)

    def unit(self, channel: str, column: str) -> str:
        """Return the standard unit of a column, in which its Series is; empty if the table does not give it."""
        own = self.units.get(channel, {}).get(column)
        return own.standard if own else ""


@dataclass(frozen=True, slots=True)
class Trial:
    """One recording; stamps are seconds of the recording's single clock, never index / rate."""

    name: str
    kind: str  # name of the excitation, free text
    source: Path
    channels: Mapping[str, Series]  # by ROBOT_CHANNELS, or by the stage.yaml of a single stage
    rail: Literal["free", "held"] = "free"
    stage: TableStage | None = None  # None for a recording of the whole robot
    warnings: tuple[str, ...] = ()  # doubts about the data, each with its remedy
    missing: Mapping[str, str] = field(default_factory=dict)  # channel -> why it is missing
    recording: str = ""  # name of the recording that a stretch was cut from

    @property
    def not_observable(self) -> dict[str, str]:
        """Stages that this recording does not show -> the reason."""
        needs = STAGE_NEEDS if self.stage is None else {}
        absent = {stage: [c for c in channels if c not in self.channels] for stage, channels in needs.items()}
        return {
            stage: f"{stage} is not observable: " + "; ".join(self.missing.get(c, f"no {c} channel") for c in channels)
            for stage, channels in absent.items()
            if channels
        }

    def channel(self, name: str) -> Series:
        """Return a channel; raise TrialError if the recording does not have it."""
        if name not in self.channels:
            why = self.missing.get(name, "the recording does not have it")
            raise TrialError(f"{self.source}: the {name} channel is missing: {why}; record it or leave this trial out")
        return self.channels[name]

    @property
    def duration_s(self) -> float:
        """Time from the first stamp to the last over all channels, s."""
        ends = [(series.t_s[0], series.t_s[-1]) for series in self.channels.values() if len(series)]
        return float(max(e for _, e in ends) - min(s for s, _ in ends)) if ends else 0.0


def stage_of(trials: Sequence[Trial]) -> TableStage:
    """Return the stage of a rig that all trials belong to."""
    (stage,) = {trial.stage.name: trial.stage for trial in trials if trial.stage is not None}.values()
    return stage


def check_links(trial: Trial, links: int) -> None:
    """Raise TrialError if mocap does not see exactly this number of links."""
    mocap = trial.channel("mocap").columns
    if f"link{links}_y" not in mocap or f"link{links + 1}_y" in mocap:
        seen = sum(name.startswith("link") and name.endswith("_y") for name in mocap)
        raise TrialError(f"{trial.source}: mocap sees {seen} links, the model has {links}; name the model of this arm")


def unique_names(trials: Iterable[Trial]) -> tuple[Trial, ...]:
    """Sort trials by name and source, so that results do not depend on the order of files.

    Raises TrialError if two trials are the same recording.
    """
    ordered = tuple(sorted(trials, key=lambda t: (t.name, str(t.source))))
    for one, other in pairwise(ordered):
        if (one.name, one.source.resolve()) == (other.name, other.source.resolve()):
            raise TrialError(f"{one.source}: the trial {one.name} is given twice; name it once")
    return ordered
