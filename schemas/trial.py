"""What stands beside a recording: trial.yaml of a folder, stage.yaml of a single-stage table (docs/trials.md)."""

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from softarm.common.quantity import factor
from softarm.schemas.base import Strict
from softarm.schemas.stage_model import LINKS_MAX, ModelValue, StageKind

__all__ = ["Column", "StageFile", "StageKind", "TableChannel", "TableTrial", "TrialFile"]


def _known(unit: str) -> str:
    factor(unit)
    return unit


# Of a column's numbers; what they are multiplied by is `softarm.common.quantity.factor`'s to say.
Unit = Annotated[str, AfterValidator(_known)]


class TrialFile(Strict):
    """trial.yaml: what a folder's recording was."""

    kind: Annotated[str, Field(min_length=1)]  # the excitation, free text
    rail: Literal["free", "held"] = "free"  # held: the cart was clamped, or its drive stood still


class Column(Strict):
    """Where a column of a table comes from."""

    source: Annotated[str, Field(min_length=1)]  # header of a column; in .mat a path: Theta1.signals.values, Y_id[0]
    unit: Unit
    row: Annotated[int, Field(ge=0)] | None = None  # of a .mat matrix whose rows are the signals
    add: float = 0.0  # then added, in the unit that diagnosis works in (a pendulum's angle that hangs at pi)


class TableChannel(Strict):
    """Columns that share stamps."""

    time: Column
    columns: Annotated[dict[str, Column], Field(min_length=1)]  # by the names that the stage's kind asks for


class TableTrial(Strict):
    """One trial: a file for each channel."""

    name: Annotated[str, Field(min_length=1)]
    kind: Annotated[str, Field(min_length=1)]  # the excitation
    files: Annotated[dict[str, str], Field(min_length=1)]  # channel -> file, relative to the data folder
    segment: str | None = None  # put in for {segment} in a column's source


class StageFile(Strict):
    """stage.yaml: one mechanism, its columns and units, its nominal model and its trials.

    Channels, columns and the model's keys by kind: `softarm.schemas.stage_model`, docs/trials.md.
    """

    name: Annotated[str, Field(min_length=1)]
    kind: StageKind
    links: Annotated[int, Field(ge=1, le=LINKS_MAX)] = 1  # of a pendulum or a chain
    # Of a chain: from the vertical, or each from the link before it. In memory they are absolute.
    angles: Literal["absolute", "relative"] = "absolute"
    # Where cells hold lists, one stage for each element: its name -> the place in the list.
    elements: dict[str, Annotated[int, Field(ge=0)]] = Field(default_factory=dict)
    channels: Annotated[dict[str, TableChannel], Field(min_length=1)]
    model: dict[str, ModelValue] = Field(default_factory=dict)  # nominal parameters
    trials: Annotated[tuple[TableTrial, ...], Field(min_length=1)]
