"""Reading of table files: text with any delimiter, Parquet, .mat and ROS bags; columns by name or number."""

import codecs
import csv
import json
import math
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from softarm.common import files
from softarm.common.quantity import factor
from softarm.common.words import did_you_mean
from softarm.diagnosis.data import bags
from softarm.diagnosis.data.trials import Array, TrialError
from softarm.schemas.trial import Column, Marks, TableForm

TEXT = (".csv", ".tsv", ".txt", ".dat")
SUFFIXES = (*TEXT, ".parquet", ".mat", *bags.SUFFIXES)
_DELIMITERS = {",": ",", ";": ";", "tab": "\t", "space": " "}
_COMMA = re.compile(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?|[-+]?\d+,(?:[eE][-+]?\d+)?")
# Source of stamps that count the rows of a table without a time column.
ROWS = "rows"
# Number of column names in a message.
_SHOWN = 12


@dataclass(frozen=True, slots=True)
class Table:
    """Columns of a table file."""

    path: Path
    columns: Mapping[str, Any]  # texts of a text table, otherwise arrays; .mat: nested like its variables
    missing: Marks
    rows: Sequence[int] | None = None  # line of each row of a text table
    named: bool = True  # False for a text table without a header; its columns are called 1, 2, ...
    comma: bool = False  # whether a decimal comma may occur

    def place(self, index: int) -> int:
        """Return the row number for messages: the line of a text table, otherwise counted from 1."""
        return self.rows[index] if self.rows is not None else index + 1


def load(path: Path, form: TableForm) -> Table:
    """Read a table file; raise TrialError with file, row and next step if it is invalid."""
    if not files.is_file(path):
        raise TrialError(f"{path}: does not exist; correct `files` in the stage.yaml, or name the data folder")
    suffix = path.suffix.lower()
    try:
        if suffix in TEXT:
            return _text(path, form)
        if suffix == ".parquet":
            from pyarrow import parquet

            table = parquet.read_table(path)
            _check_size(path, table.column_names, table.num_rows)
            return Table(path, {name: table[name].to_numpy() for name in table.column_names}, form.missing)
        if suffix == ".mat":
            return Table(path, _matlab(path), form.missing)
        if suffix in bags.SUFFIXES:
            found = bags.columns(path)
            _check_size(path, (), len(found))
            return Table(path, found, (*form.missing, "nan"))
    except TrialError:
        raise
    except Exception as error:  # a damaged file may make its library raise anything
        said = " ".join(str(error).split())
        version = " in version 7 or older" if suffix == ".mat" else ""
        raise TrialError(f"{path}: cannot be read ({said}); export it again{version}") from None
    raise TrialError(f"{path}: tables are {', '.join(SUFFIXES)}; export it as one of these")


def column(table: Table, about: Column, segment: str | None, element: int | None) -> Array:
    """Return a column in its standard unit, [N]; NaN where a cell has one of the marks for a missing value.

    segment replaces {segment} in the source; element is the index into cells that contain lists. Raises TrialError if
    the column does not exist or contains anything but numbers, or has no lists or rows to take one from.
    """
    _check_place(table, about, segment)
    marks = _marks(table, about)
    element = element if about.element is None else about.element
    values = _numbers(table, about.source, about.row, marks, segment, element)
    for source in about.minus:
        other = _numbers(table, source, about.row, marks, segment, element)
        if len(other) != len(values):
            raise TrialError(
                f"{table.path}: column {source} has {len(other)} rows, {about.source} {len(values)}; "
                "`minus` needs a column of the same length"
            )
        values = values - other
    standard_units, _ = factor(about.unit)
    return np.asarray(values * (about.scale * standard_units) + about.add)


def _check_place(table: Table, about: Column, segment: str | None) -> None:
    """Raise TrialError if a column's `element` or `row` has nothing to take one from."""
    where = f"{table.path}: column {about.source}"
    if about.element is not None and not holds_lists(table, about, segment):
        raise TrialError(f"{where} contains plain numbers, not lists; leave `element` out, or name another column")
    if about.row is not None and getattr(_find(table, _name(table, about.source, segment)), "ndim", 1) != 2:
        raise TrialError(f"{where} has no rows to choose from; leave `row` out, or name another column")


def readings(table: Table, name: str, *, blank: bool) -> Array:
    """Return a column of a robot's recording, [N]; with `blank`, an empty cell or NaN becomes NaN.

    Raises TrialError with file, column and row if a cell is not a finite number.
    """
    advice = "write nothing where a marker was not tracked" if blank else "leave the row out if nothing was measured"
    return _numbers(table, name, None, ("", "nan") if blank else (), None, None, advice)


def stamps(table: Table, about: Column, segment: str | None) -> tuple[Array, bool | None] | None:
    """Return a time column in seconds, [N], and whether its dates have time zones; None if the rows are counted.

    The second value is None if the cells are numbers, or dates of a Parquet file. Raises TrialError for an invalid
    column.
    """
    if about.source == ROWS and ROWS not in table.columns:
        return None
    raw = _find(table, _name(table, about.source, segment))
    texts = isinstance(raw, list) and any(instant(cell) for cell in raw)
    dates = isinstance(raw, np.ndarray) and raw.dtype.kind == "M"
    if not texts and not dates:
        return column(table, about, segment, None), None
    where = f"{table.path}: column {about.source}"
    if about.unit != "s" or about.scale != 1.0 or about.minus:
        raise TrialError(f"{where}: contains dates with a time of day; write only `unit: s`")
    if texts:
        found, zoned = _dates(table, raw, _missing(_marks(table, about), table.comma), where)
        return found + about.add, zoned
    found = (raw - np.datetime64(0, "s")) / np.timedelta64(1, "s")
    if np.isnan(found).any():
        raise TrialError(f"{where}, row {table.place(int(np.argmax(np.isnan(found))))}: not a date; leave that row out")
    return found + about.add, None


def instant(cell: str) -> datetime | None:
    """Return a cell as a date and time, or None if it is not one; a number such as 20261122 is not one."""
    text = cell.strip()
    if not (text[:4].isdigit() and ("T" in text or ":" in text or text.count("-") == 2)):
        return None
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        return None


def unix_s(moment: datetime) -> float:
    """Return a date and time in seconds since 1970 UTC; without a time zone it counts as UTC.

    A recording has one clock, and only differences matter.
    """
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _dates(
    table: Table, cells: Sequence[str], missing: Callable[[str | float], bool], where: str
) -> tuple[Array, bool]:
    """Return dates in seconds since 1970 UTC, [N], NaN where missing, and whether they have time zones."""
    found = np.full(len(cells), math.nan)
    zones: dict[bool, int] = {}  # whether there is a zone -> the first such cell
    for i, cell in enumerate(cells):
        if missing(cell):
            continue
        if (read := instant(cell)) is None:
            raise TrialError(
                f"{where}, row {table.place(i)}: {cell!r} is not a date and time like the others; repair that row"
            )
        zones.setdefault(read.tzinfo is not None, i)
        found[i] = unix_s(read)
    if len(zones) > 1:
        raise TrialError(
            f"{where}: row {table.place(zones[True])} has a time zone ({cells[zones[True]].strip()}), row "
            f"{table.place(zones[False])} has none ({cells[zones[False]].strip()}); write all with a time zone, or none"
        )
    return found, True in zones


def counted(about: Column, rows: int) -> Array:
    """Return the time of each counted row, s [N]."""
    return np.asarray(np.arange(rows) * (about.scale * factor(about.unit)[0]) + about.add)


def _marks(table: Table, about: Column) -> Marks:
    return table.missing if about.missing is None else about.missing


def holds_lists(table: Table, about: Column, segment: str | None) -> bool:
    """Return whether a column's cells contain lists."""
    found = _find(table, _name(table, about.source, segment))
    return isinstance(found, np.ndarray) and found.dtype == object


def _text(path: Path, form: TableForm) -> Table:
    lines = _lines(path, form.skip)
    if not lines:
        _check_size(path, (), 0)
    delimiter = _DELIMITERS[form.delimiter] if form.delimiter else _delimiter(lines[0][1])
    try:
        cells = [(row, next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))) for row, line in lines]
    except csv.Error as error:
        raise TrialError(f"{path}: cannot be read as CSV ({error}); export it as UTF-8 text with commas") from None
    if delimiter == " ":
        cells = [(row, [cell for cell in line if cell]) for row, line in cells]
    header = form.header if form.header is not None else not all(_is_value(cell, delimiter) for cell in cells[0][1])
    names = [name.strip() for name in cells[0][1]] if header else [str(i + 1) for i in range(len(cells[0][1]))]
    body = cells[1:] if header else cells
    _check_size(path, names, len(body))
    for row, line in body:
        if len(line) != len(names):
            raise TrialError(
                f"{path}: row {row} has {len(line)} cells, the {'header' if header else 'first row'} {len(names)}; "
                "repair that row, or write `table: {delimiter: ...}`"
            )
    rows = [row for row, _ in body]
    columns = {name: _cells(path, name, rows, [line[i] for _, line in body]) for i, name in enumerate(names)}
    comma = form.decimal == "," or (form.decimal is None and delimiter != ",")
    return Table(path, columns, form.missing, rows, header, comma)


def _check_size(path: Path, names: Sequence[str], rows: int) -> None:
    """Raise TrialError for a table without rows, or with two columns of one name."""
    if not rows:
        raise TrialError(f"{path}: has no rows; record some, or remove the file")
    if duplicate := {name for name in names if names.count(name) > 1}:
        raise TrialError(f"{path}: two columns are called {', '.join(sorted(duplicate))}; rename one")


def _lines(path: Path, skip: int) -> list[tuple[int, str]]:
    """Lines with their numbers from 1, without blank lines, comments and a spreadsheet's `sep=`."""
    raw = path.read_bytes()
    coding = "utf-16" if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig"
    try:
        text = raw.decode(coding)
    except UnicodeDecodeError as error:
        raise TrialError(f"{path}: cannot be read as CSV ({error}); export it as UTF-8 text with commas") from None
    found = list(enumerate(text.splitlines(), 1))[skip:]
    kept = [(row, line) for row, line in found if line.strip() and not line.lstrip().startswith(("#", "%"))]
    return kept[1:] if kept and kept[0][1].lower().startswith("sep=") else kept


def _delimiter(line: str) -> str:
    """Most likely delimiter of a line, ignoring quoted text."""
    bare = re.sub(r'"[^"]*"', "", line)
    counts = {mark: bare.count(mark) for mark in (";", "\t", ",")}
    if counts[";"]:
        return ";"  # commas are then decimal commas
    if counts["\t"]:
        return "\t"
    return "," if counts[","] or len(bare.split()) < 2 else " "


def _is_value(cell: str, delimiter: str) -> bool:
    return number(cell, delimiter != ",") is not None or instant(cell) is not None or not cell.strip()


def number(cell: str, comma: bool) -> float | None:
    """Return a cell as a number, or None if it is not one."""
    text = cell.strip()
    if comma and _COMMA.fullmatch(text):
        text = text.replace(",", ".")
    try:
        return float(text)
    except ValueError:
        return None


def _cells(path: Path, name: str, rows: Sequence[int], cells: list[str]) -> list[str] | np.ndarray[Any, Any]:
    """Cells of a text table's column, parsed if they contain lists."""
    if not cells[0].lstrip().startswith("["):
        return cells
    lists = np.empty(len(cells), dtype=object)
    for i, cell in enumerate(cells):
        try:
            lists[i] = json.loads(cell)
        except ValueError:
            raise TrialError(
                f"{path}: column {name}, row {rows[i]}: {cell[:40]!r} is not a list; repair that row"
            ) from None
    return lists


def _matlab(path: Path) -> dict[str, Any]:
    """Variables of a .mat file by name.

    The file is read in another process first, because scipy's reader (1.17) crashes on a damaged file.
    """
    from scipy.io import loadmat

    program = "import sys; from scipy.io import loadmat; loadmat(sys.argv[1])"
    tried = subprocess.run([sys.executable, "-c", program, str(path)], capture_output=True, check=False)
    if tried.returncode < 0:
        raise ValueError(f"its reader crashed with {signal.Signals(-tried.returncode).name}: the file is damaged")
    return {k: v for k, v in loadmat(path).items() if not k.startswith("__")}


def _name(table: Table, source: str | int, segment: str | None) -> str:
    """Name of a source in the table."""
    names = list(table.columns)
    if isinstance(source, str):
        source = source if segment is None else source.replace("{segment}", segment)
        if "*" not in source or source in table.columns:
            return source
        pattern = re.compile(".*".join(map(re.escape, source.split("*"))))
        fitting = [name for name in names if pattern.fullmatch(name)]
        if len(fitting) > 1:
            raise TrialError(
                f"{table.path}: {source} fits the columns {', '.join(fitting[:_SHOWN])}; allowed is one; write more of "
                "its name"
            )
        return fitting[0] if fitting else source
    if source > len(names):
        raise TrialError(f"{table.path}: no column {source}; it has {len(names)}, counted from 1; correct `source`")
    return names[source - 1]


def _numbers(
    table: Table,
    source: str | int,
    row: int | None,
    marks: Marks,
    segment: str | None,
    element: int | None,
    advice: str = "",
) -> Array:
    """Unconverted values of a source, [N]; NaN where a value is missing."""
    name = _name(table, source, segment)
    raw = _find(table, name)
    missing = _missing(marks, table.comma)
    if isinstance(raw, list):
        return _texts(table, name, raw, missing, bool(marks), advice)
    values = np.asarray(raw)
    if values.dtype == object and element is not None:  # lists in a column
        values = np.array([_element(table, name, i, cell, element) for i, cell in enumerate(values)])
    if row is not None and values.ndim == 2:
        if row >= values.shape[0]:
            raise TrialError(f"{table.path}: {name} has {values.shape[0]} rows, but `row` is {row}; correct `row`")
        values = values[row]
    try:
        if values.dtype.kind in "mM":
            raise TypeError  # dates
        values = values.reshape(-1) if values.size == max(values.shape, default=0) else values
        values = values.astype(float)
    except (TypeError, ValueError):
        raise TrialError(f"{table.path}: column {name} does not contain numbers; correct it or name another") from None
    if values.ndim != 1:
        raise TrialError(f"{table.path}: {name} has the shape {values.shape}; choose one of its rows with `row`")
    if not values.size:
        raise TrialError(f"{table.path}: column {name} is empty; name another, or leave this trial out")
    gone = np.array([missing(value) for value in values.tolist()]) if marks else np.zeros(len(values), bool)
    if (bad := np.flatnonzero(~np.isfinite(values) & ~gone)).size:
        row_text = f"row {table.place(bad[0])}: {values[bad[0]]} is not a finite number"
        every = "every row is nan" if len(bad) == len(values) else row_text
        advice = advice or "leave such rows out, or write `table: {missing: [nan]}`"
        raise TrialError(f"{table.path}: column {name}, {every}; {advice}")
    return np.where(gone, np.nan, values)


def _missing(marks: Marks, comma: bool) -> Callable[[str | float], bool]:
    """Return a test for marks of missing values: the same text, or the same number."""
    texts = {str(mark).strip().lower() for mark in marks}
    numbers = {value for mark in marks if (value := number(str(mark), False)) is not None}
    nan = any(math.isnan(value) for value in numbers)

    def missing(cell: str | float) -> bool:
        if isinstance(cell, str):
            if cell.strip().lower() in texts:
                return True
            value = number(cell, comma)
        else:
            value = cell
        return value is not None and (value in numbers or (nan and math.isnan(value)))

    return missing


def _texts(
    table: Table, name: str, cells: Sequence[str], missing: Callable[[str | float], bool], marks: bool, advice: str
) -> Array:
    """Texts as numbers, [N]; `marks`: whether a cell may be a mark of a missing value."""
    try:
        values = np.array(cells, dtype=float)
        if np.isfinite(values).all() and not (marks and any(map(missing, values.tolist()))):
            return values
    except ValueError:
        pass
    read = [math.nan if missing(cell) else number(cell, table.comma) for cell in cells]
    for i, value in enumerate(read):
        if value is None or (not math.isfinite(value) and not missing(cells[i])):
            raise TrialError(
                f"{table.path}: column {name}, row {table.place(i)}: {cells[i]!r} is not a finite number; "
                + (advice or _remedy(cells[i].strip()))
            )
    return np.array(read, dtype=float)


def _remedy(cell: str) -> str:
    """Advice about a cell that is not a number."""
    if _COMMA.fullmatch(cell):
        return "write `table: {decimal: ','}` in the stage.yaml"
    mark = cell if cell and re.fullmatch(r"[\w.+-]+", cell) else json.dumps(cell)
    return f"repair it, or if it marks a missing value write `table: {{missing: [{mark}]}}` in the stage.yaml"


def _element(table: Table, source: str, i: int, cell: Any, element: int) -> float:
    try:
        return float(cell[element])
    except (ValueError, TypeError, IndexError):
        raise TrialError(
            f"{table.path}: column {source}, row {table.place(i)}: {cell!r} has no number at place {element}; "
            "correct `element` or `elements` in the stage.yaml, or repair that row"
        ) from None


def _find(table: Table, source: str) -> Any:
    """Values of a source: a column's name, or a path in a .mat file such as Theta1.signals.values or Y_id[0]."""
    if source in table.columns:
        return table.columns[source]
    found: Any = table.columns
    for name, place in re.findall(r"([A-Za-z_]\w*)|\[(\d+)\]", source) or [("", "")]:
        try:
            found = np.asarray(found).reshape(-1)[int(place)] if place else found[name]
        except (KeyError, IndexError, ValueError, TypeError):
            raise TrialError(_no_column(table, source)) from None
        while isinstance(found, np.ndarray) and found.dtype == object and found.size == 1:
            found = found.reshape(-1)[0]
    return found


def _no_column(table: Table, source: str) -> str:
    names = list(table.columns)
    if not table.named:
        return (
            f"{table.path}: no column {source}; it has no header, but {len(names)} columns: name them by number, from 1"
        )
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    parts = [part.strip() for part in source.split(" - ")]
    if len(parts) == 2 and set(parts) <= set(names):
        hint = f"for a difference write `source: {parts[0]}, minus: {parts[1]}`"
    else:
        hint = f"{did_you_mean(source, names)}correct the stage.yaml"
    return f"{table.path}: no column {source}; it has {', '.join(names[:_SHOWN])}{more}; {hint}"
