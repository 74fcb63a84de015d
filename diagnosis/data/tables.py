"""A single-stage table of another rig: CSV, Parquet or .mat columns, and the stage.yaml that explains them."""

import json
import re
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from softarm.common.quantity import factor
from softarm.diagnosis.data import checks, stage_rules, yaml_file
from softarm.diagnosis.data.folder import numbers, read_table
from softarm.diagnosis.data.trials import Array, OwnUnit, Series, TableStage, Trial, TrialError
from softarm.schemas.stage_model import ModelValue
from softarm.schemas.trial import Column, StageFile, TableChannel, TableTrial

EXAMPLE = "one of diagnosis/rigs/stages/*.yaml"


def read(path: Path, data: Path | None = None) -> tuple[Trial, ...]:
    """Read every trial of a stage.yaml; its files lie in `data`, or beside it.

    With `elements`, one trial for each element, its name `TRIAL/ELEMENT`. Raises TrialError for what cannot
    be read or does not hold what the stage's kind needs; names file, column and row.
    """
    about = yaml_file.load(path, StageFile, EXAMPLE, stage_rules.findings)
    base = path.parent if data is None else data
    loaded: dict[Path, Any] = {}  # a file that serves many trials is read once
    return tuple(
        _trial(base, about, trial, element, loaded)
        for trial in about.trials
        for element in (about.elements or {"": -1})
    )


def _trial(base: Path, about: StageFile, trial: TableTrial, element: str, loaded: dict[Path, Any]) -> Trial:
    channels: dict[str, Series] = {}
    missing: dict[str, str] = {}
    warnings: list[str] = []
    for name, channel in about.channels.items():
        if name not in trial.files:
            missing[name] = f"trial {trial.name} names no file for it"
            continue
        path = base / trial.files[name]
        if path not in loaded:
            loaded[path] = _load(path)
        series = _series(path, loaded[path], channel, trial.segment, about.elements.get(element))
        channels[name], found = checks.tidy_stamps(series, f"{path}: {name}")
        warnings += (*found, *_range_warnings(channels[name], channel, f"{path}: {name}"))
    if not channels:
        raise TrialError(f"trial {trial.name}: names no file of {', '.join(about.channels)}; add one under files")
    if about.angles == "relative":
        channels["measured"] = _absolute(channels["measured"], about.links)
    units = {
        name: {column: OwnUnit(each.unit, *factor(each.unit)) for column, each in channel.columns.items()}
        for name, channel in about.channels.items()
    }
    stage = TableStage(element or about.name, about.kind, _in_house_units(about, units), units)
    name = f"{trial.name}/{element}" if element else trial.name
    return Trial(
        name, trial.kind, base / next(iter(trial.files.values())), channels, "free", stage, tuple(warnings), missing
    )


def _in_house_units(about: StageFile, units: Mapping[str, Mapping[str, OwnUnit]]) -> Mapping[str, ModelValue]:
    """The model as views read it: what a tracking stage has in its columns' own units is converted."""
    if about.kind != "tracking":
        return about.model
    to, from_ = (
        units["measured"][stage_rules.followed(units["measured"]) or ""].worth,
        units["command"]["command"].worth,
    )
    worth = {"gain": to / from_, "offset": to, "rate_limit": to, "acceleration_limit": to}
    return {key: _times(value, worth.get(key, 1.0), from_, to) for key, value in about.model.items()}


def _times(value: ModelValue, worth: float, from_: float, to: float) -> ModelValue:
    if isinstance(value, tuple):  # a map
        return tuple((command * from_, reached * to) for command, reached in value)  # type: ignore[misc]
    return value * worth


def _absolute(series: Series, links: int) -> Series:
    """Angles and rates, each from the vertical instead of from the link before; a rate without all before it goes."""
    columns = dict(series.columns)
    for name in ("angle", "rate"):
        own = [columns.pop(f"{name}{i}", None) for i in range(1, links + 1)]
        total = np.zeros(len(series))
        for i, each in enumerate(own, 1):
            if each is None:
                break
            total = total + each
            columns[f"{name}{i}"] = total
    return Series(series.t_s, columns)


def _load(path: Path) -> Any:
    """A file's columns, by name: text for CSV, arrays otherwise."""
    if not path.is_file():
        raise TrialError(f"{path}: is not there; correct `files` in the stage.yaml, or name the data folder")
    try:
        if path.suffix == ".csv":
            header, rows = read_table(path)
            return {name: _cells(path, name, [row[i] for row in rows]) for i, name in enumerate(header)}
        if path.suffix == ".parquet":
            from pyarrow import parquet

            table = parquet.read_table(path)
            return {name: table[name].to_numpy() for name in table.column_names}
        if path.suffix == ".mat":
            return _matlab(path)
    except TrialError:
        raise
    except Exception as error:  # whatever a damaged file makes its library raise
        raise TrialError(f"{path}: cannot be read ({error}); export it again (.mat: version 7 or older)") from None
    raise TrialError(f"{path}: tables are .csv, .parquet or .mat; export it as one of these")


def _matlab(path: Path) -> dict[str, Any]:
    """Variables by name. Read elsewhere first: of a damaged file scipy's reader (1.17) ends its process.

    Raises ValueError, and what scipy raises.
    """
    from scipy.io import loadmat

    program = "import sys; from scipy.io import loadmat; loadmat(sys.argv[1])"
    tried = subprocess.run([sys.executable, "-c", program, str(path)], capture_output=True, check=False)
    if tried.returncode < 0:
        raise ValueError(f"its reader was ended by {signal.Signals(-tried.returncode).name}: the file is damaged")
    return {k: v for k, v in loadmat(path).items() if not k.startswith("__")}


def _series(path: Path, table: Any, channel: TableChannel, segment: str | None, element: int | None) -> Series:
    time = _column(path, table, channel.time, segment, None)
    columns = {n: _column(path, table, column, segment, element) for n, column in channel.columns.items()}
    for name, values in columns.items():
        if len(values) != len(time):
            raise TrialError(
                f"{path}: column {name} has {len(values)} rows, the time column {len(time)}; cut or fill it"
            )
    return Series(time, columns)


def _column(path: Path, table: Any, column: Column, segment: str | None, element: int | None) -> Array:
    source = column.source if segment is None else column.source.replace("{segment}", segment)
    raw = _find(path, table, source)
    values = numbers(path, source, raw) if isinstance(raw, list) else np.asarray(raw)  # a list: text of a CSV file
    if values.dtype == object and element is not None:  # lists in a column
        values = np.array([_element(path, source, i, cell, element) for i, cell in enumerate(values)])
    if column.row is not None and values.ndim == 2:
        if column.row >= values.shape[0]:
            raise TrialError(
                f"{path}: {source} has {values.shape[0]} rows, row {column.row} is asked for; correct `row`"
            )
        values = values[column.row]
    try:
        values = values.reshape(-1) if values.size == max(values.shape, default=0) else values
        values = values.astype(float)
    except (TypeError, ValueError):
        raise TrialError(f"{path}: column {source} does not hold numbers; name another in the stage.yaml") from None
    if values.ndim != 1:
        raise TrialError(f"{path}: {source} is {values.shape}; say with `row` which of its rows is meant")
    if (bad := np.flatnonzero(~np.isfinite(values))).size:
        raise TrialError(f"{path}: column {source}, row {bad[0] + 1}: {values[bad[0]]}; leave such rows out")
    worth, _ = factor(column.unit)
    return values * worth + column.add


def _cells(path: Path, name: str, cells: list[str]) -> list[str] | Array:
    """A CSV column: its text, or where its cells hold lists, those."""
    if not cells[0].lstrip().startswith("["):
        return cells
    lists = np.empty(len(cells), dtype=object)
    for row, cell in enumerate(cells):
        try:
            lists[row] = json.loads(cell)
        except ValueError:
            raise TrialError(
                f"{path}: column {name}, row {row + 2}: {cell[:40]!r} is no list; repair that row"
            ) from None
    return lists


def _element(path: Path, source: str, row: int, cell: Any, element: int) -> float:
    try:
        return float(cell[element])
    except (ValueError, TypeError, IndexError):
        raise TrialError(
            f"{path}: column {source}, row {row + 2}: {cell!r} has no number at place {element}; "
            "correct `elements` in the stage.yaml, or repair that row"
        ) from None


def _find(path: Path, table: Any, source: str) -> Any:
    """Follow a source: a column's name, or in .mat names and places such as Theta1.signals.values, Y_id[0]."""
    if source in table:
        return table[source]
    found = table
    for name, place in re.findall(r"([A-Za-z_]\w*)|\[(\d+)\]", source):
        try:
            found = np.asarray(found).reshape(-1)[int(place)] if place else found[name]
        except (KeyError, IndexError, ValueError, TypeError):
            names = list(table) if isinstance(table, dict) else []
            raise TrialError(f"{path}: no column {source}; it has {', '.join(names)}; correct the stage.yaml") from None
        while isinstance(found, np.ndarray) and found.dtype == object and found.size == 1:
            found = found.reshape(-1)[0]
    return found


def _range_warnings(series: Series, channel: TableChannel, where: str) -> list[str]:
    """Ranges that no mechanism of a laboratory has in the unit that the stage.yaml names."""
    limits = {"rad": (13.0, "degrees"), "m": (20.0, "millimetres"), "kPa": (2000.0, "Pa"), "m/s": (50.0, "mm/s")}
    warnings = []
    for name, column in channel.columns.items():
        _, unit = factor(column.unit)
        top = float(np.max(np.abs(series[name] - column.add), initial=0.0))
        if unit in limits and top > limits[unit][0]:
            warnings.append(
                f"{where}: {name} goes up to {top:.4g} {unit} (from {column.source}, said to be in {column.unit}); "
                f"is it in {limits[unit][1]}? correct `unit` in the stage.yaml"
            )
    return warnings
