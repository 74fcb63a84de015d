"""Reading of ROS bags and MCAP files as tables: the numbers of every topic, by names like those of PlotJuggler."""

import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from softarm.diagnosis.data.trials import Array, TrialError
from softarm.recordings import mcap_file
from softarm.recordings.live import LIBRARY

# A ROS 2 bag is one such file or a folder of them; .bag is ROS 1.
SUFFIXES = (".mcap", ".db3", ".bag")
# Column of each topic: the header's stamp, or without one the reception; s since 1970.
TIME = "time"
# Arrays without names are split up to this length; longer ones are images, point clouds or covariances.
LENGTH_MAX = 32
# Messages above this size hold images or point clouds, and their topic is left out.
MESSAGE_MAX = 16_384
_NAMES = ("name", "joint_names")
_NANOSECONDS = ("nanosec", "nsec", "nanosecs")
INSTALL = "install it: pip install 'softarm[ros]'"


def columns(path: Path) -> dict[str, Array]:
    """Return the numbers of a bag by `TOPIC/FIELD`, each [messages of the topic], NaN where a message has none.

    Values that belong to named joints are called `TOPIC/JOINT/FIELD`. Each topic has `TOPIC/time`.

    Raises:
        TrialError: the file is a log of this project, has another encoding than CDR and JSON, or needs the extra `ros`.
        Exception: of the library, for a damaged file.
    """
    topics: dict[str, list[dict[str, float]]] = {}
    left_out: set[str] = set()
    for topic, received_s, size, message in _messages(path):
        if size > MESSAGE_MAX:
            left_out.add(topic)
        elif topic not in left_out:
            row = dict(_numbers(topic, message, ()))
            stamp = row.pop(f"{topic}/header/stamp", 0.0)
            topics.setdefault(topic, []).append({f"{topic}/{TIME}": stamp or received_s} | row)
    found: dict[str, Array] = {}
    for topic in topics.keys() - left_out:
        rows = topics[topic]
        for name in dict.fromkeys(name for row in rows for name in row):
            found[name] = np.array([row.get(name, np.nan) for row in rows])
    return dict(sorted(found.items()))


def topic_of(column: str, names: Collection[str]) -> str:
    """Return the topic of a column: the longest one that has a time column and begins the name."""
    topics = [name.removesuffix(f"/{TIME}") for name in names if name.endswith(f"/{TIME}")]
    return max((topic for topic in topics if column.startswith(f"{topic}/")), key=len, default="")


def _messages(path: Path) -> Iterator[tuple[str, float, int, Any]]:
    """Yield topic, time of reception in s, size in bytes and content of each message."""
    if path.suffix.lower() == ".mcap":
        library, encoding = mcap_file.origin(path)
        if library == LIBRARY:
            raise TrialError(f"{path}: a log of the robot; `softarm diagnose` reads it without a stage file")
        if encoding == "json":
            for topic, logged_ns, data in mcap_file.stamped_messages(path):
                yield topic, logged_ns / 1e9, len(data), json.loads(data)
            return
        if encoding not in ("cdr", ""):
            raise TrialError(
                f"{path}: its messages are in {encoding}; allowed are json and cdr (ROS 2); export the topics as CSV"
            )
    yield from _ros_messages(path)


def _ros_messages(path: Path) -> Iterator[tuple[str, float, int, Any]]:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise TrialError(f"{path}: reading ROS bags needs rosbags; {INSTALL}") from None
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        known = [each for each in reader.connections if each.msgtype in reader.typestore.fielddefs]
        for connection, received_ns, raw in reader.messages(known):
            small = len(raw) <= MESSAGE_MAX
            message = reader.deserialize(raw, connection.msgtype) if small else None
            yield connection.topic, received_ns / 1e9, len(raw), message


def _numbers(path: str, value: Any, names: Sequence[str]) -> Iterator[tuple[str, float]]:
    """Yield the numbers of a message with their names; names are those of the joints that arrays refer to."""
    value = _fields(value)
    if isinstance(value, bool | int | float | np.number):
        yield path, float(value)
    elif isinstance(value, Mapping):
        nanoseconds = next((value[name] for name in _NANOSECONDS if name in value), None)
        if nanoseconds is not None and len(value) == 2:
            yield path, float(next(iter(value.values()))) + nanoseconds / 1e9
            return
        own = next((value[name] for name in _NAMES if _are_texts(value.get(name))), names)
        for name, inner in value.items():
            yield from _numbers(f"{path}/{name}", inner, own)
    elif isinstance(value, Sequence | np.ndarray) and not isinstance(value, str | bytes):
        yield from _elements(path, value, names)


def _fields(value: Any) -> Any:
    """Return a ROS message as a mapping; anything else unchanged."""
    names = getattr(value, "__dataclass_fields__", None)
    return value if names is None else {name: getattr(value, name) for name in names if name != "__msgtype__"}


def _elements(path: str, values: Any, names: Sequence[str]) -> Iterator[tuple[str, float]]:
    """Yield the numbers of an array: of named joints, of frames of /tf, or by index."""
    parent, _, field = path.rpartition("/")
    if len(values) == len(names):
        for name, value in zip(names, values, strict=True):
            yield from _numbers(f"{parent}/{name}/{field}", value, ())
    elif len(values) <= LENGTH_MAX:
        for index, value in enumerate(values):
            fields = _fields(value)
            frame = fields.get("child_frame_id") if isinstance(fields, Mapping) else None
            yield from _numbers(f"{parent}/{frame}" if frame else f"{path}[{index}]", value, names)


def _are_texts(value: Any) -> bool:
    return isinstance(value, Sequence) and bool(value) and all(isinstance(each, str) for each in value)
