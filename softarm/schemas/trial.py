"""Data models of trial.yaml (of a folder) and stage.yaml (of a mechanism's tables), see docs/reference/trials.md."""

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from softarm.common.quantity import factor
from softarm.schemas.base import Strict
from softarm.schemas.stage_model import LINKS_MAX, ModelValue, StageKind


def _pure(unit: object) -> object:
    return "1" if unit == 1 else unit  # as YAML reads it without quotes


def _listed(value: object) -> object:
    """Return one value without brackets as a list of one; a list unchanged."""
    return tuple(value) if isinstance(value, list) else (value,) if isinstance(value, str | int | float) else value


def _known(unit: str) -> str:
    factor(unit)
    return unit


# Unit of a column; `softarm.common.quantity.factor` converts it.
Unit = Annotated[str, BeforeValidator(_pure), AfterValidator(_known)]
# Cells that mean "not measured", such as -9999 or "n/a"; also in .mat and Parquet.
Marks = Annotated[tuple[str | float, ...], BeforeValidator(_listed)]


class TrialFile(Strict):
    """Data model of trial.yaml: the conditions of a recording."""

    kind: Annotated[str, Field(min_length=1)]  # the excitation, free text
    rail: Literal["free", "held"] = "free"  # held: the cart was clamped, or its drive stood still


# A column by its header, or by its number from 1 without headers; in .mat a path: Theta1.signals.values, Y_id[0].
# An asterisk in a name stands for any text.
Source = Annotated[str, Field(min_length=1)] | Annotated[int, Field(ge=1)]


class Column(Strict):
    """Source of a column of a table: (source - minus) x scale in `unit`, converted to base units, plus `add`."""

    source: Source
    # Other columns of the same file, in the same unit.
    minus: Annotated[tuple[Source, ...], BeforeValidator(_listed)] = ()
    unit: Unit
    scale: float = 1.0  # value of 1 in the column, in `unit`: 0.0879 deg for a count of 4096
    row: Annotated[int, Field(ge=0)] | None = None  # of a .mat matrix whose rows are the signals
    element: Annotated[int, Field(ge=0)] | None = None  # place in the lists that the column's cells hold
    missing: Marks | None = None  # instead of those of the table
    add: float = 0.0  # added last, in base units: -pi for an angle that is pi while the pendulum hangs


class TableForm(Strict):
    """Format of text tables; missing keys are detected."""

    header: bool | None = None  # true: the first row has names; false: a source is a column's number
    delimiter: Literal[",", ";", "tab", "space"] | None = None
    decimal: Literal[".", ","] | None = None
    skip: Annotated[int, Field(ge=0)] = 0  # number of lines before the header
    missing: Marks = ()


class TableChannel(Strict):
    """Columns that share time stamps."""

    time: Column
    columns: Annotated[dict[str, Column], Field(min_length=1)]  # by the names that the kind of stage requires


class TableTrial(Strict):
    """One trial: a file for each channel, or one for all. A path with * gives a trial for each matching file."""

    name: Annotated[str, Field(min_length=1)] | None = None  # default: the text that * matches, or the file's name
    kind: Annotated[str, Field(min_length=1)] | None = None  # the excitation; default: the name without its number
    # Channel -> file, relative to the data folder.
    files: Annotated[str, Field(min_length=1)] | Annotated[dict[str, str], Field(min_length=1)]
    segment: str | None = None  # replaces {segment} in a column's source
    split: Annotated[str, Field(min_length=1)] | None = None  # column with another number for each trial of a file
    # Seconds after the recording's first row; rows outside are left out.
    from_s: Annotated[float, Field(ge=0)] = 0.0
    to_s: Annotated[float, Field(gt=0)] | None = None

    @model_validator(mode="after")
    def _is_window(self) -> Self:
        if self.to_s is not None and self.to_s <= self.from_s:
            raise ValueError(
                f"to_s is {self.to_s:g}, not after from_s ({self.from_s:g}); allowed above "
                f"{self.from_s:g} s; correct one"
            )
        return self


class Mechanism(Strict):
    """One mechanism: its columns, their units and its nominal model.

    Channels, columns and the model's keys by kind: `softarm.schemas.stage_model`, docs/reference/trials.md.
    """

    kind: StageKind
    links: Annotated[int, Field(ge=1, le=LINKS_MAX)] = 1  # of a pendulum or a chain
    # Angles of a chain: from the vertical, or each from the link before it.
    angles: Literal["absolute", "relative"] = "absolute"
    # If cells hold lists, one stage for each element: its name -> the index in the list.
    elements: dict[str, Annotated[int, Field(ge=0)]] = Field(default_factory=dict)
    channels: Annotated[dict[str, TableChannel], Field(min_length=1)]
    model: dict[str, ModelValue] = Field(default_factory=dict)  # nominal parameters

    @property
    def parts(self) -> tuple[str, ...]:
        """Return the names of the stages: of a MuJoCo model its measured joints; empty for a single stage."""
        measured = self.channels.get("measured")
        return tuple(measured.columns if self.kind == "mujoco" and measured else self.elements)


Effects = dict[str, dict[str, float]]  # `stage.effect` -> parameter -> value, in the units of a verdict


class StageFile(Mechanism):
    """Data model of a stage.yaml with one mechanism."""

    name: Annotated[str, Field(min_length=1)] | None = None  # default: the file's name, for `stage.yaml` its folder's
    table: TableForm = TableForm()
    trials: Annotated[tuple[TableTrial, ...], Field(min_length=1)]
    effects: Effects = Field(default_factory=dict)  # of the nominal model, besides `model`


class OneOfSeveral(Mechanism):
    """One of several mechanisms, with its own trials or those of the whole file."""

    trials: tuple[TableTrial, ...] = ()


class SeveralFile(Strict):
    """Data model of a stage.yaml with several mechanisms by name."""

    mechanisms: Annotated[dict[str, OneOfSeveral], Field(min_length=1)]
    table: TableForm = TableForm()
    trials: tuple[TableTrial, ...] = ()
    effects: Effects = Field(default_factory=dict)
