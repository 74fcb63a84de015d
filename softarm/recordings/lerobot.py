"""Logs as a LeRobot dataset, format 3.0: one episode for each reach goal, with the policy's inputs and actions.

Format: huggingface/lerobot, `lerobot/datasets` (`info.json`, `stats.json`, Parquet files of data, episodes and tasks).
"""

import json
import math
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softarm.common import files
from softarm.recordings import flight, tables
from softarm.schemas.goals import GoalStatus
from softarm.schemas.messages import Command
from softarm.schemas.policy import Observation
from softarm.schemas.robot import CONTROL_RATE_HZ

STATE = (*Observation._fields, "target_y_m", "target_z_m")
ACTIONS = Command._fields[1:]  # without the drive's enable
TASK = "swing the tip onto the target"
_ROBOT = "softarm"
_FILE = "chunk-000/file-000.parquet"
_NAMES = {"observation.state": STATE, "action": ACTIONS}
_EXPORT = "write one with `softarm logs export --to lerobot`"
_QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}


@dataclass(frozen=True, slots=True)
class Episode:
    """One goal: policy inputs [T, 10], actions [T, 2], and whether the tip reached the target."""

    state: NDArray[np.float32]
    action: NDArray[np.float32]
    reached: bool


@dataclass(frozen=True, slots=True)
class Written:
    """Content of a new dataset."""

    episodes: int
    reached: int
    frames: int
    left_out: int  # incomplete goals


def episodes(path: Path) -> Iterator[Episode | None]:
    """Yield the reach goals of a log in their order, and None for one that is incomplete.

    A goal is complete if each of its ticks has an observation and an action, no tick is missing, and its end is
    recorded.

    Raises:
        LogError: The file is not a log.
    """
    rows: list[tuple[int, list[float], list[float]]] = []
    status = GoalStatus()
    for moment in flight.moments(path):
        if moment is None:
            continue
        out = moment.tick.outputs
        if rows and (out.goal.number != status.number or out.goal.state != "running"):
            yield complete(rows, out.goal.state == "reached" and out.goal.number == status.number)
            rows = []
        status = out.goal
        if status.state == "running" and status.goal is not None and status.goal.kind == "reach":
            seen = [*out.observed.values] if out.observed else [math.nan] * len(Observation._fields)
            target = [status.goal.y_m, status.goal.z_m]
            rows.append((out.tick, [*seen, *target], [*(out.action or (math.nan, math.nan))]))
    if rows:
        yield None  # the log ends within this goal


def complete(rows: Sequence[tuple[int, list[float], list[float]]], reached: bool) -> Episode | None:
    """Return the episode of a goal's ticks, inputs and actions; None if a tick or a number is missing."""
    ticks, state, action = (np.array(column) for column in zip(*rows, strict=True))
    if np.any(np.diff(ticks) != 1) or not (np.isfinite(state).all() and np.isfinite(action).all()):
        return None
    return Episode(state.astype(np.float32), action.astype(np.float32), reached)


def write(folder: Path, found: Iterable[Episode | None]) -> Written:
    """Write a dataset, replacing an earlier one in the folder.

    Raises:
        ValueError: There is no complete goal, or the folder holds data of another program.
        OSError: The folder cannot be written.
        ModuleNotFoundError: pyarrow is not installed.
    """
    import pyarrow

    _check_own(folder)
    every = list(found)
    kept = [episode for episode in every if episode is not None]
    if not kept:
        raise ValueError(f"no complete reach goal; {len(every)} are incomplete; name logs in which the arm swung")
    for name in ("data", "meta"):
        shutil.rmtree(folder / name, ignore_errors=True)
    for name in ("data", "meta/episodes"):
        (folder / name / _FILE).parent.mkdir(parents=True)
    parts = [_columns(episode, k) for k, episode in enumerate(kept)]
    ends = np.cumsum([len(episode.state) for episode in kept])
    data = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    data["index"] = np.arange(ends[-1])
    tables.write_arrow(folder / "data" / _FILE, tables.arrow(data))
    rows = []
    for k, (part, end) in enumerate(zip(parts, ends.tolist(), strict=True)):
        length = len(kept[k].state)
        about = {"episode_index": k, "tasks": [TASK], "length": length, "data/chunk_index": 0, "data/file_index": 0}
        about |= {"dataset_from_index": end - length, "dataset_to_index": end}
        own = _statistics(part | {"index": np.arange(end - length, end)})
        about |= {f"stats/{name}/{key}": value for name, of in own.items() for key, value in of.items()}
        rows.append(about | {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0})
    tables.write_arrow(folder / "meta/episodes" / _FILE, pyarrow.Table.from_pylist(rows))
    tables.write_arrow(folder / "meta/tasks.parquet", _tasks())
    files.write_text(folder / "meta/stats.json", json.dumps(_statistics(data), indent=1) + "\n")
    files.write_text(folder / "meta/info.json", json.dumps(_info(len(kept), int(ends[-1]), data), indent=1) + "\n")
    return Written(len(kept), sum(episode.reached for episode in kept), int(ends[-1]), len(every) - len(kept))


def read(folder: Path) -> list[Episode]:
    """Read the episodes of a dataset of this robot, of format 3.0 or 2.1.

    Without `next.success`, as in recordings of other programs, every episode counts as reached.

    Raises:
        ValueError: The folder holds no such dataset; states what is wrong and the remedy.
        ModuleNotFoundError: pyarrow is not installed.
    """
    import pyarrow
    from pyarrow import parquet

    try:
        info = json.loads((folder / "meta/info.json").read_text(encoding="utf-8"))
        features, version, fps = info["features"], info["codebase_version"], info["fps"]
        names = {name: tuple(features[name]["names"]) for name in _NAMES}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{folder}: no dataset of this robot ({error}); {_EXPORT}") from None
    if version not in ("v3.0", "v2.1") or fps != CONTROL_RATE_HZ or names != _NAMES:
        raise ValueError(
            f"{folder}: has {version}, {fps} frames a second and the columns {names}; "
            f"allowed v3.0 or v2.1, {CONTROL_RATE_HZ} and {_NAMES}: {_EXPORT}"
        )
    wanted = [*_NAMES, "episode_index", "frame_index", *(["next.success"] if "next.success" in features else [])]
    try:
        found = [parquet.read_table(path, columns=wanted) for path in sorted(folder.glob("data/*/*.parquet"))]
        table = pyarrow.concat_tables(found).sort_by([("episode_index", "ascending"), ("frame_index", "ascending")])
    except (OSError, pyarrow.ArrowInvalid) as error:
        raise ValueError(f"{folder}: its Parquet files cannot be read ({error}); {_EXPORT}") from None
    state, action = (np.stack(table[name].to_numpy()).astype(np.float32) for name in _NAMES)
    success = table["next.success"].to_numpy() if "next.success" in features else np.ones(len(state), dtype=bool)
    begins = np.flatnonzero(np.diff(table["episode_index"].to_numpy(), prepend=-1))
    parts = zip(*(np.split(each, begins[1:]) for each in (state, action, success)), strict=True)
    return [Episode(seen, done, bool(reached.any())) for seen, done, reached in parts]


def _check_own(folder: Path) -> None:
    """Raise ValueError unless data in the folder are a dataset that `write` has written."""
    if not any((folder / name).exists() for name in ("data", "meta")):
        return
    try:
        own = json.loads((folder / "meta/info.json").read_text(encoding="utf-8"))["robot_type"] == _ROBOT
    except (OSError, ValueError, KeyError, TypeError):
        own = False
    if not own:
        raise ValueError(
            f"{folder}: has data or meta of another origin; only a dataset of `softarm logs export` is replaced; "
            "choose another --out"
        )


def _columns(episode: Episode, number: int) -> dict[str, NDArray[Any]]:
    """Return the columns of an episode, without its place in the dataset."""
    size = len(episode.state)
    last = np.arange(size) == size - 1
    return {
        "observation.state": episode.state,
        "action": episode.action,
        "next.done": last,
        "next.success": last & episode.reached,
        "timestamp": (np.arange(size) / CONTROL_RATE_HZ).astype(np.float32),
        "frame_index": np.arange(size),
        "episode_index": np.full(size, number),
        "task_index": np.zeros(size, dtype=np.int64),
    }


def _info(count: int, frames: int, data: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    return {
        "codebase_version": "v3.0",
        "robot_type": _ROBOT,
        "total_episodes": count,
        "total_frames": frames,
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": CONTROL_RATE_HZ,
        "splits": {"train": f"0:{count}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": {
            name: {"dtype": str(values.dtype), "shape": [*(values.shape[1:] or (1,))], "names": _NAMES.get(name)}
            for name, values in data.items()
        },
    }


def _statistics(columns: Mapping[str, NDArray[Any]]) -> dict[str, dict[str, list[Any]]]:
    """Return minimum, maximum, mean, deviation, count and quantiles of each column."""
    found = {}
    for name, values in columns.items():
        x = values.reshape(len(values), -1).astype(float)
        of = {"min": x.min(0), "max": x.max(0), "mean": x.mean(0), "std": x.std(0)}
        of |= {key: np.quantile(x, share, axis=0) for key, share in _QUANTILES.items()}
        found[name] = {key: each.tolist() for key, each in of.items()} | {"count": [len(values)]}
    return found


def _tasks() -> Any:
    """Return the table of tasks, whose index pandas reads as their names."""
    import pyarrow

    index = "__index_level_0__"
    columns = [
        {"name": name, "field_name": field, "pandas_type": kind, "numpy_type": kind, "metadata": None}
        for name, field, kind in (("task_index", "task_index", "int64"), (None, index, "object"))
    ]
    about = {"index_columns": [index], "column_indexes": [], "columns": columns, "pandas_version": "2.0.0"}
    table = pyarrow.table({"task_index": [0], index: [TASK]})
    return table.replace_schema_metadata({"pandas": json.dumps(about)})
