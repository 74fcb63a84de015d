"""Log as CSV or Parquet tables, with one row per tick and units in the column names."""

import csv
import io
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from softarm.common import files
from softarm.recordings import flight
from softarm.recordings.flight import Moment, Outputs, Tick
from softarm.recordings.log_file import LogFile
from softarm.schemas.events import Entry
from softarm.schemas.messages import SAFE

Form = Literal["csv", "parquet"]
# Column -> cells of equal length: numbers (NaN: no value), booleans, texts or times (datetime64[ns], UTC).
Table = Mapping[str, Sequence[Any] | NDArray[Any]]
Advance = Callable[[], None]  # called for every message read

_NS = 1e-9
_TICK = tuple(flight.figures(Moment(Tick(outputs=Outputs(t_ns=0, sent=SAFE)), None, None, None)))


def write(path: Path, table: Table) -> None:
    """Write a table as .csv or .parquet, replacing an existing file. Numbers keep every digit.

    Raises:
        OSError: The file cannot be written.
        ModuleNotFoundError: pyarrow is not installed.
    """
    if path.suffix == ".parquet":
        write_arrow(path, arrow(table))
        return
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    writer.writerows(zip(*(_cells(column) for column in table.values()), strict=True))
    files.write_text(path, text.getvalue())


def write_arrow(path: Path, table: Any) -> None:
    """Write a `pyarrow.Table` as .parquet, replacing an existing file. Raises OSError as `write` does."""
    from pyarrow import parquet

    with files.replacing(path) as file:
        parquet.write_table(table, file)


def about(log: LogFile) -> str:
    """Return the header of a log as JSON: configuration, software, machine, clock, policies."""
    said = {name: dict(values) for name, values in log.metadata.items()}
    for values in said.values():
        if "json" in values:
            values |= json.loads(values.pop("json"))
    return json.dumps(said | {"policies": [dict(policy) for policy in log.policies]}, indent=1) + "\n"


def ticks(log: LogFile, advance: Advance = lambda: None) -> Table:
    """Return a row for every tick of the log: inputs, decisions, durations.

    `t_s` counts from the first message of the log, as in `softarm diagnose`; the columns of devices hold the
    newest readings of the tick.

    Raises:
        LogError: The file cannot be read as a log.
    """
    offset_ns = flight.wall_minus_monotonic_ns(log.path, log.metadata)
    rows: list[tuple[Any, ...]] = []
    stamps: list[int] = []
    origin_ns = flight.first_stamp_ns(log.path)
    for one in flight.moments(log.path):
        advance()
        if one is not None:
            stamps.append(one.tick.outputs.t_ns)
            rows.append(tuple(flight.figures(one).values()))
    since = np.array(stamps, dtype=np.int64) - origin_ns
    columns = dict(zip(_TICK, zip(*rows, strict=True), strict=True)) if rows else dict.fromkeys(_TICK, ())
    return {"time_utc": _instants(stamps, offset_ns), "t_s": since * _NS, **columns}


def events(log: LogFile, entries: Sequence[Entry]) -> Table:
    """Return a row for every event."""
    offset_ns = flight.wall_minus_monotonic_ns(log.path, log.metadata)
    origin_ns = flight.first_stamp_ns(log.path)
    stamps = [entry.t_ns for entry in entries]
    return {
        "time_utc": _instants(stamps, offset_ns),
        "t_s": (np.array(stamps, dtype=np.int64) - origin_ns) * _NS,
        "tick": [entry.tick for entry in entries],
        **{name: [str(getattr(entry, name) or "") for entry in entries] for name in ("kind", "what", "who", "text")},
    }


def _instants(stamps_ns: Sequence[int], offset_ns: int) -> NDArray[np.datetime64]:
    return (np.array(stamps_ns, dtype=np.int64) + offset_ns).astype("datetime64[ns]")


def _cells(column: Sequence[Any] | NDArray[Any]) -> list[Any]:
    """Return the cells for `csv`: numbers with all digits, empty without a value."""
    if isinstance(column, np.ndarray) and column.dtype.kind == "M":
        return [f"{text}Z" for text in np.datetime_as_string(column).tolist()]
    return ["" if cell != cell else cell for cell in (column.tolist() if isinstance(column, np.ndarray) else column)]


def arrow(table: Table) -> Any:
    """Return a table as a `pyarrow.Table`, with null for a missing value; a matrix becomes lists of fixed length.

    Raises:
        ModuleNotFoundError: pyarrow is not installed.
    """
    import pyarrow

    def array(column: Sequence[Any] | NDArray[Any]) -> Any:
        if isinstance(column, np.ndarray) and column.dtype.kind == "M":
            return pyarrow.array(column, pyarrow.timestamp("ns", tz="UTC"))
        if isinstance(column, np.ndarray) and column.ndim == 2:
            return pyarrow.FixedSizeListArray.from_arrays(pyarrow.array(column.reshape(-1)), column.shape[1])
        return pyarrow.array(np.asarray(column) if len(column) else np.array([], dtype=float), from_pandas=True)

    return pyarrow.table({name: array(column) for name, column in table.items()})
