"""Tables as files: text with any delimiter, Parquet, .mat; their columns by name or number, as numbers."""

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
from pathlib import Path
from typing import Any

import numpy as np

from softarm.common.words import did_you_mean
from softarm.diagnosis.data import instants
from softarm.diagnosis.data.trials import Array, TrialError
from softarm.schemas.trial import Column, TableForm

TEXT = (".csv", ".tsv", ".txt", ".dat")
_DELIMITERS = {",": ",", ";": ";", "tab": "\t", "space": " "}
_COMMA = re.compile(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?|[-+]?\d+,(?:[eE][-+]?\d+)?")
_SHOWN = 12  # names of columns in a message


@dataclass(frozen=True, slots=True)
class Table:
    """A file's columns."""

    path: Path
    columns: Mapping[str, Any]  # texts of a text table, arrays of the others; .mat: as deep as its variables
    rows: Sequence[int] | None  # of a text table: the line that each row stands in
    named: bool  # False: a text table without a header, whose columns are called 1, 2, ...
    comma: bool  # a decimal comma may occur

    def place(self, index: int) -> int:
        """The row that people find a value in: of a text table its line in the file."""
        return self.rows[index] if self.rows is not None else index + 1


def load(path: Path, form: TableForm) -> Table:
    """Read a file. Raises TrialError that names it, and the row, and the next step."""
    if not path.is_file():
        raise TrialError(f"{path}: is not there; correct `files` in the stage.yaml, or name the data folder")
    suffix = path.suffix.lower()
    try:
        if suffix in TEXT:
            return _text(path, form)
        if suffix == ".parquet":
            from pyarrow import parquet

            table = parquet.read_table(path)
            return Table(path, {name: table[name].to_numpy() for name in table.column_names}, None, True, False)
        if suffix == ".mat":
            return Table(path, _matlab(path), None, True, False)
    except TrialError:
        raise
    except Exception as error:  # whatever a damaged file makes its library raise
        said = " ".join(str(error).split())
        raise TrialError(f"{path}: cannot be read ({said}); export it again (.mat: version 7 or older)") from None
    raise TrialError(f"{path}: tables are {', '.join(TEXT)}, .parquet or .mat; export it as one of these")


def column(table: Table, about: Column, form: TableForm, segment: str | None, element: int | None) -> Array:
    """A column's numbers in the house's unit, [N]; NaN where the form says that nothing was measured.

    element: the place in cells that hold lists. Raises TrialError.
    """
    from softarm.common.quantity import factor

    values = _numbers(table, about.source, about.row, form, segment, element)
    if about.minus is not None:
        other = _numbers(table, about.minus, about.row, form, segment, element)
        if len(other) != len(values):
            raise TrialError(
                f"{table.path}: column {about.minus} has {len(other)} rows, {about.source} {len(values)}; "
                "`minus` needs a column of the same length"
            )
        values = values - other
    worth, _ = factor(about.unit)
    return np.asarray(values * (about.scale * worth) + about.add)


def stamps(table: Table, about: Column, form: TableForm, segment: str | None) -> tuple[Array, bool | None]:
    """A time column in seconds, [N], as `column` reads it or by its dates; and whether those have time zones.

    None: its cells are numbers, or dates of a Parquet file. Raises TrialError.
    """
    raw = _find(table, _name(table, about.source, segment))
    texts = isinstance(raw, list) and any(instants.instant(cell) for cell in raw)
    dates = isinstance(raw, np.ndarray) and raw.dtype.kind == "M"
    if not texts and not dates:
        return column(table, about, form, segment, None), None
    where = f"{table.path}: column {about.source}"
    if about.unit != "s" or about.scale != 1.0 or about.minus is not None:
        raise TrialError(f"{where}: holds dates with a time of day; write `unit: s` alone")
    if texts:
        found, zoned = instants.seconds(raw, _missing(form), table.place, where)
        return found + about.add, zoned
    found = (raw - np.datetime64(0, "s")) / np.timedelta64(1, "s")
    if np.isnan(found).any():
        raise TrialError(f"{where}, row {table.place(int(np.argmax(np.isnan(found))))}: no date; leave that row out")
    return found + about.add, None


def holds_lists(table: Table, about: Column, segment: str | None) -> bool:
    """Whether a column's cells hold lists."""
    found = _find(table, _name(table, about.source, segment))
    return isinstance(found, np.ndarray) and found.dtype == object


def _text(path: Path, form: TableForm) -> Table:
    lines = _lines(path, form.skip)
    if not lines:
        raise TrialError(f"{path}: has no rows; record some, or take the file away")
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
    if not body:
        raise TrialError(f"{path}: has no rows; record some, or take the file away")
    if duplicate := {name for name in names if names.count(name) > 1}:
        raise TrialError(f"{path}: two columns are called {', '.join(sorted(duplicate))}; rename one")
    for row, line in body:
        if len(line) != len(names):
            raise TrialError(
                f"{path}: row {row} has {len(line)} cells, the {'header' if header else 'first row'} {len(names)}; "
                "repair that row, or say `table: {delimiter: ...}`"
            )
    rows = [row for row, _ in body]
    columns = {name: _cells(path, name, rows, [line[i] for _, line in body]) for i, name in enumerate(names)}
    return Table(path, columns, rows, header, form.decimal == "," or (form.decimal is None and delimiter != ","))


def _lines(path: Path, skip: int) -> list[tuple[int, str]]:
    """Lines with their numbers from 1, without blank ones, comments and a spreadsheet's `sep=`."""
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
    """What parts the cells of a line; outside quotes and lists."""
    bare = re.sub(r'"[^"]*"', "", line)
    counts = {mark: bare.count(mark) for mark in (";", "\t", ",")}
    if counts[";"]:
        return ";"  # commas beside it are decimal ones
    if counts["\t"]:
        return "\t"
    return "," if counts[","] or len(bare.split()) < 2 else " "


def _is_value(cell: str, delimiter: str) -> bool:
    return _number(cell, delimiter != ",") is not None or instants.instant(cell) is not None or not cell.strip()


def _number(cell: str, comma: bool) -> float | None:
    text = cell.strip()
    if comma and _COMMA.fullmatch(text):
        text = text.replace(",", ".")
    try:
        return float(text)
    except ValueError:
        return None


def _cells(path: Path, name: str, rows: Sequence[int], cells: list[str]) -> list[str] | np.ndarray[Any, Any]:
    """A text table's column: its text, or where its cells hold lists, those."""
    if not cells[0].lstrip().startswith("["):
        return cells
    lists = np.empty(len(cells), dtype=object)
    for i, cell in enumerate(cells):
        try:
            lists[i] = json.loads(cell)
        except ValueError:
            raise TrialError(
                f"{path}: column {name}, row {rows[i]}: {cell[:40]!r} is no list; repair that row"
            ) from None
    return lists


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


def _name(table: Table, source: str | int, segment: str | None) -> str:
    """A source as the table calls it."""
    if isinstance(source, str):
        return source if segment is None else source.replace("{segment}", segment)
    names = list(table.columns)
    if source > len(names):
        raise TrialError(f"{table.path}: no column {source}; it has {len(names)}, counted from 1; correct `source`")
    return names[source - 1]


def _numbers(
    table: Table, source: str | int, row: int | None, form: TableForm, segment: str | None, element: int | None
) -> Array:
    """A source's numbers as they stand, [N]; NaN where the form says so."""
    name = _name(table, source, segment)
    raw = _find(table, name)
    missing = _missing(form)
    if isinstance(raw, list):
        return _texts(table, name, raw, missing, bool(form.missing))
    values = np.asarray(raw)
    if values.dtype == object and element is not None:  # lists in a column
        values = np.array([_element(table, name, i, cell, element) for i, cell in enumerate(values)])
    if row is not None and values.ndim == 2:
        if row >= values.shape[0]:
            raise TrialError(f"{table.path}: {name} has {values.shape[0]} rows, row {row} is asked for; correct `row`")
        values = values[row]
    try:
        values = values.reshape(-1) if values.size == max(values.shape, default=0) else values
        values = values.astype(float)
    except (TypeError, ValueError):
        raise TrialError(f"{table.path}: column {name} does not hold numbers; name another in the stage.yaml") from None
    if values.ndim != 1:
        raise TrialError(f"{table.path}: {name} is {values.shape}; say with `row` which of its rows is meant")
    if not values.size:
        raise TrialError(f"{table.path}: column {name} is empty; name another, or leave this trial out")
    gone = np.array([missing(value) for value in values.tolist()]) if form.missing else np.zeros(len(values), bool)
    if (bad := np.flatnonzero(~np.isfinite(values) & ~gone)).size:
        every = "every row is nan" if len(bad) == len(values) else f"row {table.place(bad[0])}: {values[bad[0]]}"
        raise TrialError(
            f"{table.path}: column {name}, {every}; leave such rows out, or write `table: {{missing: [nan]}}`"
        )
    return np.where(gone, np.nan, values)


def _missing(form: TableForm) -> Callable[[str | float], bool]:
    """Whether a cell is one of the form's marks: the same text, or the same number."""
    texts = {str(mark).strip().lower() for mark in form.missing}
    numbers = {value for mark in form.missing if (value := _number(str(mark), False)) is not None}
    nan = any(math.isnan(value) for value in numbers)

    def missing(cell: str | float) -> bool:
        if isinstance(cell, str):
            if cell.strip().lower() in texts:
                return True
            value = _number(cell, False)
        else:
            value = cell
        return value is not None and (value in numbers or (nan and math.isnan(value)))

    return missing


def _texts(table: Table, name: str, cells: Sequence[str], missing: Callable[[str | float], bool], marks: bool) -> Array:
    """Texts as numbers, [N]; marks: there are any."""
    try:
        values = np.array(cells, dtype=float)
        if np.isfinite(values).all() and not (marks and any(map(missing, values.tolist()))):
            return values
    except ValueError:
        pass
    read = [math.nan if missing(cell) else _number(cell, table.comma) for cell in cells]
    for i, value in enumerate(read):
        if value is None or (not math.isfinite(value) and not missing(cells[i])):
            raise TrialError(
                f"{table.path}: column {name}, row {table.place(i)}: {cells[i]!r} is not a finite number; "
                + _remedy(cells[i].strip())
            )
    return np.array(read, dtype=float)


def _remedy(cell: str) -> str:
    """What to do about a cell that holds no number."""
    if _COMMA.fullmatch(cell):
        return "write `table: {decimal: ','}` in the stage.yaml"
    mark = cell if cell and re.fullmatch(r"[\w.+-]+", cell) else json.dumps(cell)
    return f"repair it, or where nothing was measured write `table: {{missing: [{mark}]}}` in the stage.yaml"


def _element(table: Table, source: str, i: int, cell: Any, element: int) -> float:
    try:
        return float(cell[element])
    except (ValueError, TypeError, IndexError):
        raise TrialError(
            f"{table.path}: column {source}, row {table.place(i)}: {cell!r} has no number at place {element}; "
            "correct `elements` in the stage.yaml, or repair that row"
        ) from None


def _find(table: Table, source: str) -> Any:
    """Follow a source: a column's name, or in .mat names and places such as Theta1.signals.values, Y_id[0]."""
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
