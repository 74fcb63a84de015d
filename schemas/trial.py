"""What stands beside a recording: trial.yaml of a folder, stage.yaml of a single-stage table (docs/trials.md)."""

from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from softarm.common.quantity import factor
from softarm.schemas.base import Strict
from softarm.schemas.stage_model import LINKS_MAX, ModelValue, StageKind

__all__ = ["Column", "Mechanism", "SeveralFile", "StageFile", "StageKind", "TableForm", "TableTrial", "TrialFile"]


def _pure(unit: object) -> object:
    return "1" if unit == 1 else unit  # as YAML reads it without quotes


def _known(unit: str) -> str:
    factor(unit)
    return unit


# Of a column's numbers; what they are multiplied by is `softarm.common.quantity.factor`'s to say.
Unit = Annotated[str, BeforeValidator(_pure), AfterValidator(_known)]


class TrialFile(Strict):
    """trial.yaml: what a folder's recording was."""

    kind: Annotated[str, Field(min_length=1)]  # the excitation, free text
    rail: Literal["free", "held"] = "free"  # held: the cart was clamped, or its drive stood still


# A column by its header; by its number where there is none, from 1; in .mat a path: Theta1.signals.values, Y_id[0].
Source = Annotated[str, Field(min_length=1)] | Annotated[int, Field(ge=1)]


class Column(Strict):
    """Where a column of a table comes from: (source - minus) x scale, in `unit`; then converted; then + add."""

    source: Source
    minus: Source | None = None  # another column of the same file, in the same unit
    unit: Unit
    scale: float = 1.0  # what one of the column's numbers is worth in `unit`: 0.0879 deg for one count of 4096
    row: Annotated[int, Field(ge=0)] | None = None  # of a .mat matrix whose rows are the signals
    add: float = 0.0  # then added, in the unit that diagnosis works in (a pendulum's angle that hangs at pi)


class TableForm(Strict):
    """How text tables are written; what is left out is found out."""

    header: bool | None = None  # names in the first row; without them a source is a column's number
    delimiter: Literal[",", ";", "tab", "space"] | None = None
    decimal: Literal[".", ","] | None = None
    skip: Annotated[int, Field(ge=0)] = 0  # so many lines before the header
    missing: tuple[
        str | float, ...
    ] = ()  # cells that stand for "not measured": NaN, "", -9999; of .mat and Parquet too


class TableChannel(Strict):
    """Columns that share stamps."""

    time: Column
    columns: Annotated[dict[str, Column], Field(min_length=1)]  # by the names that the stage's kind asks for


class TableTrial(Strict):
    """One trial: a file for each channel, or one for all. With * in a path, a trial for each file that fits."""

    name: Annotated[str, Field(min_length=1)] | None = None  # default: what stands for the *, or the file's name
    kind: Annotated[str, Field(min_length=1)] | None = None  # the excitation; default: the name less its number
    # Channel -> file, relative to the data folder.
    files: Annotated[str, Field(min_length=1)] | Annotated[dict[str, str], Field(min_length=1)]
    segment: str | None = None  # put in for {segment} in a column's source


class Mechanism(Strict):
    """One mechanism: its columns and units, its nominal model.

    Channels, columns and the model's keys by kind: `softarm.schemas.stage_model`, docs/trials.md.
    """

    kind: StageKind
    links: Annotated[int, Field(ge=1, le=LINKS_MAX)] = 1  # of a pendulum or a chain
    # Of a chain: from the vertical, or each from the link before it. In memory they are absolute.
    angles: Literal["absolute", "relative"] = "absolute"
    # Where cells hold lists, one stage for each element: its name -> the place in the list.
    elements: dict[str, Annotated[int, Field(ge=0)]] = Field(default_factory=dict)
    channels: Annotated[dict[str, TableChannel], Field(min_length=1)]
    model: dict[str, ModelValue] = Field(default_factory=dict)  # nominal parameters


class StageFile(Mechanism):
    """stage.yaml of one mechanism."""

    name: Annotated[str, Field(min_length=1)] | None = None  # default: the file's, of a `stage.yaml` its folder's
    table: TableForm = TableForm()
    trials: Annotated[tuple[TableTrial, ...], Field(min_length=1)]


class OneOfSeveral(Mechanism):
    """A mechanism of several; its trials are its own, or those of the whole file."""

    trials: tuple[TableTrial, ...] = ()


class SeveralFile(Strict):
    """stage.yaml of several mechanisms: by name."""

    mechanisms: Annotated[dict[str, OneOfSeveral], Field(min_length=1)]
    table: TableForm = TableForm()
    trials: tuple[TableTrial, ...] = ()
