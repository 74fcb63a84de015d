"""A trial folder: CSV or Parquet files that another stack recorded, beside a trial.yaml."""

import csv
import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from softarm.common import files
from softarm.common.quantity import with_unit
from softarm.diagnosis.data import checks, yaml_file
from softarm.diagnosis.data.trials import LINKS, ROBOT_CHANNELS, Array, Series, Trial, TrialError, mocap_columns
from softarm.recordings import tables
from softarm.schemas.trial import TrialFile

EXAMPLE = "`kind: chirp` and `rail: held`"
FORMS = (".csv", ".parquet")
LINKS_MAX = 12
_NOT_FINITE = {  # whether a reading may be missing
    True: "is not a finite number; write nothing where a marker was not seen",
    False: "is not a finite number; leave the row out if nothing was measured",
}


def is_trial(folder: Path) -> bool:
    """Does the folder hold a trial?"""
    return (folder / "trial.yaml").is_file()


def read(folder: Path) -> Trial:
    """Read a trial folder. A file that is not there makes its stages not observable, in words.

    Raises TrialError for a file, column or row that cannot be read, and for a folder without any data.
    """
    about = yaml_file.load(folder / "trial.yaml", TrialFile, EXAMPLE)
    channels: dict[str, Series] = {}
    missing: dict[str, str] = {}
    warnings: list[str] = []
    for name in ROBOT_CHANNELS:
        files = [path for form in FORMS if (path := folder / f"{name}{form}").is_file()]
        if not files:
            missing[name] = f"there is no {name}.csv in {folder}"
            continue
        if len(files) > 1:
            raise TrialError(
                f"{folder}: holds {' and '.join(f.name for f in files)}; take the one away that is not meant"
            )
        (path,) = files
        channels[name], found = checks.tidy_stamps(_channel(path, name), str(path))
        warnings += found
    if not channels:
        names = ", ".join(f"{name}.csv" for name in ROBOT_CHANNELS)
        raise TrialError(f"{folder}: holds none of {names}; put the recording there (docs/trials.md)")
    warnings += checks.unit_warnings(channels, str(folder))
    return Trial(folder.name, about.kind, folder, channels, about.rail, None, tuple(warnings), missing)


def _channel(path: Path, name: str) -> Series:
    found, columns_of = (_parquet if path.suffix == ".parquet" else _csv)(path)
    units = mocap_columns(LINKS_MAX) if name == "mocap" else ROBOT_CHANNELS[name]
    time = _time(name)
    bare = {with_unit(column, unit): column for column, unit in {time: "s", **units}.items()}
    header = {bare.get(column, column): column for column in found}  # `pressure_kpa` is `pressure`
    if len(header) < len(found):
        twice = next(column for column, spelt in header.items() if column in found and spelt != column)
        raise TrialError(f"{path}: {twice} and {header[twice]} are one column; take one away")
    if name == "mocap":
        links = sum(f"link{i}_y" in header for i in range(1, LINKS_MAX + 1))
        units = mocap_columns(links or LINKS)
    wanted = (time, *units)
    if lacking := [column for column in wanted if column not in header]:
        raise TrialError(
            f"{path}: no column {', '.join(lacking)}; it has {', '.join(header) or 'none'}, "
            f"and needs {', '.join(wanted)} (docs/trials.md)"
        )
    # A marker may be out of sight; every other reading is there or its row is not.
    columns = {column: columns_of(header[column], column.endswith(("_y", "_z", "_angle"))) for column in wanted}
    return Series(columns.pop(time), columns)


def write(trial: Trial, folder: Path, form: tables.Form) -> None:
    """Write a recording of the robot as a trial folder, a unit in every column's name; `read` gives the same back.

    A reading that is no number has no row. Raises OSError; ModuleNotFoundError as `tables.write` does.
    """
    for name, series in trial.channels.items():
        units = {_time(name): "s", **ROBOT_CHANNELS[name]}
        columns = np.stack([series.t_s, *(series[column] for column in ROBOT_CHANNELS[name])])
        if name != "mocap":
            columns = columns[:, np.isfinite(columns).all(axis=0)]
        names = (with_unit(column, unit) for column, unit in units.items())
        tables.write(folder / f"{name}.{form}", dict(zip(names, columns, strict=True)))
    files.write_text(folder / "trial.yaml", f"kind: {json.dumps(trial.kind)}\nrail: {trial.rail}\n")


def _time(channel: str) -> str:
    return "t_capture" if channel == "mocap" else "t"


# A table's header, and its columns as numbers by name; True: a reading may be missing.
_Columns = tuple[list[str], Callable[[str, bool], Array]]


def _csv(path: Path) -> _Columns:
    header, rows = read_table(path)
    return header, lambda name, blank: numbers(path, name, [row[header.index(name)] for row in rows], blank=blank)


def _parquet(path: Path) -> _Columns:
    """Raises TrialError for what is no Parquet file or has no rows."""
    import pyarrow
    from pyarrow import parquet

    try:
        table = parquet.read_table(path)
    except (OSError, pyarrow.ArrowException) as error:
        said = " ".join(str(error).split())
        raise TrialError(f"{path}: cannot be read as Parquet ({said}); export it again, or as CSV") from None
    if duplicate := {name for name in table.column_names if table.column_names.count(name) > 1}:
        raise TrialError(f"{path}: two columns are called {', '.join(sorted(duplicate))}; rename one")
    if not table.num_rows:
        raise TrialError(f"{path}: has no rows; record some, or take the file away")

    def column(name: str, blank: bool) -> Array:
        try:
            if pyarrow.types.is_temporal(table[name].type):
                raise TypeError
            values = table[name].to_numpy().astype(float)  # a null is NaN
        except (TypeError, ValueError):
            raise TrialError(f"{path}: column {name} holds {table[name].type}; write it as numbers") from None
        if len(bad := np.flatnonzero(~(np.isfinite(values) | (blank & np.isnan(values))))):
            raise TrialError(f"{path}: column {name}, row {bad[0] + 1}: {values[bad[0]]} {_NOT_FINITE[blank]}")
        return np.array(values)

    return table.column_names, column


def read_table(path: Path) -> tuple[list[str], list[list[str]]]:
    """Header and rows of a CSV file, as text. Raises TrialError for a row of another length or no rows."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            lines = list(csv.reader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise TrialError(f"{path}: cannot be read as CSV ({error}); export it as UTF-8 text with commas") from None
    header = [name.strip() for name in lines[0]] if lines else []
    rows = [line for line in lines[1:] if line]
    if not rows:
        raise TrialError(f"{path}: has no rows; record some, or take the file away")
    if duplicate := {name for name in header if header.count(name) > 1}:
        raise TrialError(f"{path}: two columns are called {', '.join(sorted(duplicate))}; rename one")
    for number, line in enumerate(lines[1:], 2):
        if line and len(line) != len(header):
            raise TrialError(f"{path}: row {number} has {len(line)} cells, the header {len(header)}; repair that row")
    return header, rows


def numbers(path: Path, column: str, cells: Sequence[str], *, blank: bool = False) -> Array:
    """Cells as numbers [N]; with `blank`, an empty cell or nan is NaN.

    Raises TrialError that names file, column and row (the header is row 1).
    """
    try:
        values = np.array(cells, dtype=float)
    except ValueError:
        values = np.array([_number(cell) if cell.strip() or not blank else np.nan for cell in cells])
        values = values.astype(float) if None not in values.tolist() else values
    bad = [v is None or not (np.isfinite(v) or (blank and np.isnan(v))) for v in values.tolist()]
    if any(bad):
        at = bad.index(True)
        raise TrialError(f"{path}: column {column}, row {at + 2}: {cells[at]!r} {_NOT_FINITE[blank]}")
    return values


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None
