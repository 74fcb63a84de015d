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
from softarm.common.quantity import with_unit
from softarm.recordings import flight
from softarm.recordings.flight import Moment
from softarm.recordings.log_file import LogFile
from softarm.schemas.events import Entry
from softarm.schemas.policy import OBSERVATION

Form = Literal["csv", "parquet"]
# Column -> cells of equal length: numbers (NaN: no value), booleans, texts or times (datetime64[ns], UTC).
Table = Mapping[str, Sequence[Any] | NDArray[Any]]
Advance = Callable[[], None]  # called for every message read

_NS = 1e-9
_MS = 1e-6
_OBSERVATION = tuple(with_unit(f"observed_{signal.name}", signal.unit) for signal in OBSERVATION)
_NOTHING = (float("nan"),) * len(OBSERVATION)


def write(path: Path, table: Table) -> None:
    """Write a table as .csv or .parquet, replacing an existing file. Numbers keep every digit.

    Raises:
        OSError: The file cannot be written.
        ModuleNotFoundError: pyarrow is not installed.
    """
    files.write_bytes(path, _parquet(table) if path.suffix == ".parquet" else _csv(table))


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
            rows.append(_row(one))
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


_TICK = (
    *("tick", "mode", "estop", "policy", "goal_number", "goal_kind", "goal_state", "target_y_m", "target_z_m"),
    *("closest_m", "sent_enable", "sent_cart_velocity_m_s", "sent_pressure_kpa", "action_cart_velocity_m_s"),
    *("action_pressure_kpa", "measured_pressure_kpa", "rail_position_m", "rail_velocity_m_s", *_OBSERVATION),
    *("bridged_s", "mocap_age_ms", "pressure_age_ms", "rail_age_ms", "late_ms", "missed_ticks", "policy_ms", "read_ms"),
    *("compute_ms", "write_ms", "sensor_to_command_ms", "clamps", "events"),
)


def _row(moment: Moment) -> tuple[Any, ...]:
    nan = float("nan")
    out, timing = moment.tick.outputs, moment.tick.timing
    goal, status, seen = out.goal.goal, out.goal, out.observed
    ages = (seen.mocap_age_ns, seen.pressure_age_ns, seen.rail_age_ns) if seen else None
    whole = timing.sensor_to_command_ns
    return (
        *(out.tick, out.mode, out.estop, out.policy),
        *(status.number, goal.kind if goal else "", status.state),
        *((goal.y_m, goal.z_m) if goal else (nan, nan)),
        nan if status.closest_m is None else status.closest_m,
        *out.sent,
        *(out.action or (nan, nan)),
        moment.pressure.pressure_kpa if moment.pressure else nan,
        *((moment.rail.position_m, moment.rail.velocity_m_s) if moment.rail else (nan, nan)),
        *(seen.values if seen else _NOTHING),
        seen.bridged_ns * _NS if seen else nan,
        *((age * _MS for age in ages) if ages else (nan,) * 3),
        *(out.late_ns * _MS, out.missed, out.policy_ns * _MS),
        *(timing.read_ns * _MS, timing.compute_ns * _MS, timing.write_ns * _MS),
        nan if whole is None else whole * _MS,
        *(" ".join(out.clamps), " ".join(event.name for event in out.events)),
    )


def _instants(stamps_ns: Sequence[int], offset_ns: int) -> NDArray[np.datetime64]:
    return (np.array(stamps_ns, dtype=np.int64) + offset_ns).astype("datetime64[ns]")


def _csv(table: Table) -> bytes:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    writer.writerows(zip(*(_cells(column) for column in table.values()), strict=True))
    return text.getvalue().encode()


def _cells(column: Sequence[Any] | NDArray[Any]) -> list[Any]:
    """Return the cells for `csv`: numbers with all digits, empty without a value."""
    if isinstance(column, np.ndarray) and column.dtype.kind == "M":
        return [f"{text}Z" for text in np.datetime_as_string(column).tolist()]
    return ["" if cell != cell else cell for cell in (column.tolist() if isinstance(column, np.ndarray) else column)]


def _parquet(table: Table) -> bytes:
    import pyarrow
    from pyarrow import parquet

    def array(column: Sequence[Any] | NDArray[Any]) -> Any:
        if isinstance(column, np.ndarray) and column.dtype.kind == "M":
            return pyarrow.array(column, pyarrow.timestamp("ns", tz="UTC"))
        return pyarrow.array(np.asarray(column) if len(column) else np.array([], dtype=float), from_pandas=True)

    buffer = io.BytesIO()
    parquet.write_table(pyarrow.table({name: array(column) for name, column in table.items()}), buffer)
    return buffer.getvalue()
