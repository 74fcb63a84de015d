"""Reading and writing of trial folders: CSV or Parquet files of another stack, with a trial.yaml."""

import json
from pathlib import Path

import numpy as np

from softarm.common import files, yaml_lines
from softarm.common.quantity import with_unit
from softarm.common.yaml_lines import FileError
from softarm.common.yaml_schema import fit
from softarm.diagnosis.data import checks, table_files
from softarm.diagnosis.data.trials import LINKS, ROBOT_CHANNELS, Series, Trial, TrialError, mocap_columns
from softarm.recordings import tables
from softarm.schemas.trial import TableForm, TrialFile

EXAMPLE = "`kind: chirp` and `rail: held`"
FORMS = (".csv", ".parquet")
LINKS_MAX = 12
_CSV = TableForm(delimiter=",", header=True)
# A marker may be untracked; rows without any other reading are left out of a file.
_MAY_BE_BLANK = ("_y", "_z", "_angle")


def is_trial(folder: Path) -> bool:
    """Return whether a folder contains a trial."""
    return (folder / "trial.yaml").is_file()


def read(folder: Path) -> Trial:
    """Read a trial folder; a missing file makes its stages not observable.

    Raises TrialError if a file, column or row is invalid, or the folder contains no data.
    """
    try:
        about = fit(yaml_lines.read(folder / "trial.yaml", f"write one, e.g. {EXAMPLE}"), TrialFile)
    except FileError as error:
        raise TrialError(str(error)) from None
    channels: dict[str, Series] = {}
    missing: dict[str, str] = {}
    warnings: list[str] = []
    for name in ROBOT_CHANNELS:
        files = [path for form in FORMS if (path := folder / f"{name}{form}").is_file()]
        if not files:
            missing[name] = f"there is no {name}.csv in {folder}"
            continue
        if len(files) > 1:
            raise TrialError(f"{folder}: contains {' and '.join(f.name for f in files)}; remove one of them")
        (path,) = files
        channels[name], found = checks.tidy_stamps(_channel(path, name), str(path))
        warnings += found
    if not channels:
        names = ", ".join(f"{name}.csv" for name in ROBOT_CHANNELS)
        raise TrialError(f"{folder}: contains none of {names}; put the recording there (docs/reference/trials.md)")
    warnings += checks.unit_warnings(channels, str(folder))
    return Trial(folder.name, about.kind, folder, channels, about.rail, None, tuple(warnings), missing)


def _channel(path: Path, name: str) -> Series:
    table = table_files.load(path, _CSV)
    units = mocap_columns(LINKS_MAX) if name == "mocap" else ROBOT_CHANNELS[name]
    time = _time(name)
    bare = {with_unit(column, unit): column for column, unit in {time: "s", **units}.items()}
    header: dict[str, str] = {}
    for column in table.columns:
        known = header.setdefault(bare.get(column, column), column)  # `pressure_kpa` is `pressure`
        if known != column:
            raise TrialError(f"{path}: {known} and {column} are the same column; remove one")
    if name == "mocap":
        links = sum(f"link{i}_y" in header for i in range(1, LINKS_MAX + 1))
        units = mocap_columns(links or LINKS)
    wanted = (time, *units)
    if lacking := [column for column in wanted if column not in header]:
        raise TrialError(
            f"{path}: no column {', '.join(lacking)}; it has {', '.join(header) or 'none'}, "
            f"and needs {', '.join(wanted)} (docs/reference/trials.md)"
        )
    columns = {
        column: table_files.readings(table, header[column], blank=column.endswith(_MAY_BE_BLANK)) for column in wanted
    }
    return Series(columns.pop(time), columns)


def write(trial: Trial, folder: Path, form: tables.Form) -> None:
    """Write a recording of the robot as a trial folder that `read` reads back without a difference.

    Column names contain units. Rows with a NaN reading are left out, except for mocap. Raises OSError if a file cannot
    be written, and ModuleNotFoundError as `tables.write` does.
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
