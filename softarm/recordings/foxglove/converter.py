"""Logs for Foxglove: conversion of messages and schemas, one by one, for files and live data; export of a file."""

import json
import math
import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from mcap import records
from mcap.writer import Writer
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from softarm.common import files as atomic
from softarm.recordings import flight, mcap_file
from softarm.recordings.flight import Moment, Tick
from softarm.recordings.foxglove import scene
from softarm.recordings.live import LIBRARY, LogMessage, register
from softarm.recordings.log_file import LogFile
from softarm.reporting.colours import on_any_ground
from softarm.schemas.config import Config
from softarm.schemas.events import Entry
from softarm.schemas.messages import MocapFrame, PressureReading, RailReading

_KEPT = ("title", "description", "type", "enum", "const", "format")
Node = dict[str, Any]


def plain(schema: bytes) -> bytes:
    """Return the schema of an object in this form. Raises KeyError if a reference has no definition."""
    root: Node = json.loads(schema)
    return json.dumps(_plain(root, root.get("$defs", {})), allow_nan=False).encode()


def _plain(node: Node, named: Node) -> Node:
    if "$ref" in node:
        node = named[node["$ref"].rpartition("/")[2]] | {name: node[name] for name in _KEPT if name in node}
    if "anyOf" in node:
        first = next((one for one in node["anyOf"] if one.get("type") != "null"), {"type": "string"})
        return _plain(first, named) | {name: node[name] for name in ("title", "description") if name in node}
    made = {name: node[name] for name in _KEPT if name in node}
    made.setdefault("type", "string")  # of listed values without a type
    if made["type"] == "object":
        fields = node.get("properties", {})
        made["properties"] = {name: _plain(field, named) for name, field in fields.items()}
        made["required"] = [name for name in node.get("required", ()) if not _nullable(fields[name])]
    if made["type"] == "array":
        made["items"] = _plain(node.get("items") or (node.get("prefixItems") or [{"type": "string"}])[0], named)
    return made


def _nullable(node: Node) -> bool:
    return any(one.get("type") == "null" for one in node.get("anyOf", ()))


FIXED, FRAMES, ROBOT, TARGET, SHELF = "/tf_static", "/tf", "/scene/robot", "/scene/target", "/scene/shelf"
TRAIL, TRAIL_NS, TRAIL_STEP_NS = "/scene/trail", 1_500_000_000, 50_000_000  # trail of the tip: duration and steps
STATE, JOURNAL = "/state", "/log"
INFO, WARNING, ERROR = 2, 3, 4  # foxglove.LogLevel
_SCHEMAS = files("softarm.recordings.foxglove") / "schemas"


class Channel(NamedTuple):
    """Topic with the name of its type in Foxglove and its JSON schema."""

    topic: str
    schema_name: str
    json_schema: bytes


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


# null for NaN and infinity: a plot's line has a gap there, while it goes on straight over a field that is absent.
_Number = Annotated[float | None, BeforeValidator(_finite)]


class State(BaseModel):
    """Tick as flat numbers for plots; null where a value is missing, although Foxglove's schemas cannot state that."""

    model_config = ConfigDict(allow_inf_nan=False)

    tick: int
    mode: str
    estop: str
    policy: str
    goal_state: str
    events: str  # of the failsafe table, separated by blanks
    clamps: str  # reasons why the sent command differs from the requested one
    enabled: bool = Field(validation_alias="sent_enable")
    target_y_m: _Number
    target_z_m: _Number
    tip_y_m: _Number = Field(validation_alias="observed_tip_y_m")
    tip_z_m: _Number = Field(validation_alias="observed_tip_z_m")
    tip_to_target_m: _Number
    cart_position_m: _Number = Field(validation_alias="observed_cart_position_m")
    cart_velocity_m_s: _Number = Field(validation_alias="observed_cart_velocity_m_s")
    cart_velocity_requested_m_s: _Number = Field(validation_alias="action_cart_velocity_m_s")
    cart_velocity_sent_m_s: float = Field(validation_alias="sent_cart_velocity_m_s")
    rail_position_m: _Number
    rail_velocity_m_s: _Number
    pressure_requested_kpa: _Number = Field(validation_alias="action_pressure_kpa")
    pressure_sent_kpa: float = Field(validation_alias="sent_pressure_kpa")
    pressure_measured_kpa: _Number = Field(validation_alias="measured_pressure_kpa")
    late_ms: float
    missed_ticks: int
    compute_ms: float
    policy_ms: float
    mocap_age_ms: _Number
    pressure_age_ms: _Number
    rail_age_ms: _Number


def channels() -> tuple[Channel, ...]:
    """Return the channels that a converter adds to those of the log."""
    kinds = {
        **dict.fromkeys((FIXED, FRAMES), "FrameTransforms"),
        **dict.fromkeys((ROBOT, TARGET, SHELF, TRAIL), "SceneUpdate"),
        JOURNAL: "Log",
    }
    state = Channel(STATE, "softarm.State", plain(json.dumps(State.model_json_schema(mode="serialization")).encode()))
    return (*(Channel(topic, f"foxglove.{kind}", _schema(kind)) for topic, kind in kinds.items()), state)


def own(channel: records.Channel, schema: records.Schema) -> Channel:
    """Return one of the log's channels with its schema in Foxglove's form."""
    return Channel(channel.topic, schema.name, plain(schema.data))


def _schema(kind: str) -> bytes:
    """Return one of Foxglove's schemas; its files have each shared type once, in shared.json."""
    shared, schema = (json.loads((_SCHEMAS / f"{name}.json").read_text()) for name in ("shared", kind))
    return (json.dumps(_inline(schema, shared), indent=1) + "\n").encode()


def _inline(node: Any, shared: dict[str, Any]) -> Any:
    """Return a part of a schema with the shared types in place of their references."""
    if isinstance(node, list):
        return [_inline(each, shared) for each in node]
    if not isinstance(node, dict):
        return node
    node = dict(node)
    if "$ref" in node:
        node = shared[node.pop("$ref").rpartition("/")[2]] | node
    return {name: _inline(each, shared) for name, each in node.items()}


class Converter:
    """Converter of a log's messages in file order."""

    def __init__(self, config: Config, wall_minus_monotonic_ns: int, repeat_s: float = math.inf) -> None:
        """Create a converter.

        Args:
            config: Configuration of the recording.
            wall_minus_monotonic_ns: Offset to wall-clock time.
            repeat_s: Interval at which unchanged scenes are repeated for viewers that connect later.
        """
        self._config, self._offset_ns = config, wall_minus_monotonic_ns
        self._repeat_s = repeat_s
        self._shown: dict[str, str] = {}  # topic -> text of the inputs of its scene
        self._shown_ns = 0
        self._tip: deque[tuple[int, float, float]] = deque()  # time and position
        self._pressure: PressureReading | None = None
        self._rail: RailReading | None = None
        self.has_events = False

    def take(self, topic: str, log_time: int, publish_time: int, data: bytes) -> Iterator[LogMessage]:
        """Yield a message with wall-clock stamps, and the messages that show it.

        Raises:
            pydantic.ValidationError: The message has another format.
        """
        at_ns = log_time + self._offset_ns
        yield LogMessage(topic, at_ns, publish_time + self._offset_ns, data)
        one = flight.record(topic, data)
        match one:
            case MocapFrame():
                seen_ns = one.t_capture_ns + self._offset_ns
                yield LogMessage(FRAMES, at_ns, seen_ns, _json(scene.frames(one, seen_ns)))
                if self._goes_on(one, seen_ns):
                    yield LogMessage(TRAIL, at_ns, seen_ns, _json(scene.trail([at[1:] for at in self._tip], seen_ns)))
            case PressureReading():
                self._pressure = one
            case RailReading():
                self._rail = one
            case Entry():
                self.has_events = True
                yield self.journal(one)
            case Tick():
                yield from self._scenes(one, at_ns)
                yield LogMessage(STATE, at_ns, at_ns, self._state(one).model_dump_json().encode())

    def journal(self, entry: Entry) -> LogMessage:
        """Return an event as foxglove.Log."""
        at_ns = entry.t_ns + self._offset_ns
        refused = entry.accepted is False
        level = ERROR if entry.kind == "stop" else WARNING if refused or entry.kind in ("lost", "event") else INFO
        text = {"timestamp": scene.time_of(at_ns), "level": level, "message": entry.text, "name": entry.kind}
        return LogMessage(JOURNAL, at_ns, at_ns, _json(text | {"file": "", "line": 0}))

    def _goes_on(self, frame: MocapFrame, seen_ns: int) -> bool:
        """Return whether the trail of the tip has a new point."""
        if frame.from_another_clock:
            return False
        tip = frame.bodies[-1]
        since_ns = seen_ns - self._tip[-1][0] if self._tip else TRAIL_STEP_NS
        if not (tip.tracked and math.isfinite(tip.y_m + tip.z_m)) or since_ns < TRAIL_STEP_NS:
            return False
        self._tip.append((seen_ns, tip.y_m, tip.z_m))
        while seen_ns - self._tip[0][0] > TRAIL_NS:
            self._tip.popleft()
        return True

    def _scenes(self, tick: Tick, at_ns: int) -> Iterator[LogMessage]:
        """Yield the scenes that have changed."""
        out, config = tick.outputs, self._config
        goal = (out.goal.goal, out.goal.state)
        # Topic: inputs of the scene, and the scene.
        scenes: dict[str, tuple[object, Callable[[], scene.Json]]] = {
            FIXED: (None, lambda: scene.fixed_frames(at_ns)),
            ROBOT: (None, lambda: scene.robot(config, at_ns)),
            TARGET: (goal, lambda: scene.target(out.goal, config.goals.success_radius_m, at_ns)),
            SHELF: ((*goal, out.policy), lambda: scene.shelf(out.goal, out.policy, config, at_ns)),
        }
        is_due = (at_ns - self._shown_ns) * 1e-9 >= self._repeat_s
        if is_due:
            self._shown_ns = at_ns
        for topic, (of, made) in scenes.items():
            inputs = repr(of)  # as text, since NaN does not equal itself
            if is_due or self._shown.get(topic) != inputs:
                self._shown[topic] = inputs
                yield LogMessage(topic, at_ns, at_ns, _json(made()))

    def _state(self, tick: Tick) -> State:
        known = flight.figures(Moment(tick, None, self._pressure, self._rail))
        across_m, up_m = (known[f"observed_tip_{axis}_m"] - known[f"target_{axis}_m"] for axis in "yz")
        return State.model_validate(known | {"tip_to_target_m": math.hypot(across_m, up_m)})


def _json(value: Any) -> bytes:
    return json.dumps(value, separators=(",", ":"), allow_nan=False).encode()


Advance = Callable[[], None]


def layout() -> str:
    """Return the layout for Foxglove: 3D, plots, states and journal, in the colours of `softarm.reporting`."""
    text = (files("softarm.recordings.foxglove") / "layout.json").read_text(encoding="utf-8")
    return re.sub(r'"color": "([a-z]+)"', lambda found: f'"color": "{_hex(found[1])}"', text)


def _hex(name: str) -> str:
    return "#" + "".join(f"{round(255 * part):02x}" for part in on_any_ground(name))


def export(log: LogFile, target: Path, entries: Iterable[Entry], advance: Advance = lambda: None) -> None:
    """Write a log and its events for Foxglove; the log itself is not changed.

    Raises:
        LogError: The log cannot be read.
        OSError: The file cannot be written.
    """
    offset_ns = flight.wall_minus_monotonic_ns(log.path, log.metadata)
    changing = Converter(log.config, offset_ns)
    with atomic.replacing(target) as file:
        writer = Writer(file)
        writer.start(profile="", library=LIBRARY)
        ids = {channel.topic: register(writer, *channel) for channel in channels()}
        schemas: dict[int, records.Schema] = {}
        count = 0

        def put(message: LogMessage) -> None:
            nonlocal count
            count += 1
            writer.add_message(ids[message.topic], message.log_time, message.data, message.publish_time, count)

        for topic, record in mcap_file.records(log.path):
            match record:
                case records.Schema():
                    schemas[record.id] = record
                case records.Channel() if record.topic not in ids:  # a finished log repeats it at its end
                    ids[record.topic] = register(writer, *own(record, schemas[record.schema_id]))
                case records.Metadata():
                    writer.add_metadata(record.name, record.metadata)
                case records.Message():
                    advance()
                    try:
                        for message in changing.take(topic, record.log_time, record.publish_time, record.data):
                            put(message)
                    except ValidationError as error:
                        raise flight.unreadable(log.path, topic, error) from None
        if not changing.has_events:
            for entry in entries:
                put(changing.journal(entry))
        writer.finish()
