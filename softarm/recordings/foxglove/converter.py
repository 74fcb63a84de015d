"""Conversion of a log's messages to Foxglove's, one by one, for files and live data."""

import json
import math
from collections import deque
from collections.abc import Callable, Iterator
from importlib.resources import files
from typing import Any, NamedTuple

from mcap import records
from pydantic import ConfigDict, TypeAdapter
from pydantic.dataclasses import dataclass

from softarm.recordings import flight
from softarm.recordings.flight import Tick
from softarm.recordings.foxglove import scene
from softarm.recordings.foxglove.plain import plain
from softarm.recordings.live import LogMessage
from softarm.schemas.config import Config
from softarm.schemas.events import Entry
from softarm.schemas.messages import MocapFrame, PressureReading, RailReading

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


@dataclass(frozen=True, slots=True, config=ConfigDict(allow_inf_nan=False))
class State:
    """Tick as flat numbers for plots, without missing values."""

    tick: int
    mode: str
    estop: str
    policy: str
    goal_state: str
    events: str  # of the failsafe table, separated by blanks
    clamps: str  # reasons why the sent command differs from the requested one
    enabled: bool
    target_y_m: float | None
    target_z_m: float | None
    tip_y_m: float | None
    tip_z_m: float | None
    tip_to_target_m: float | None
    cart_position_m: float | None
    cart_velocity_m_s: float | None
    cart_velocity_requested_m_s: float | None
    cart_velocity_sent_m_s: float
    rail_position_m: float | None
    rail_velocity_m_s: float | None
    pressure_requested_kpa: float | None
    pressure_sent_kpa: float
    pressure_measured_kpa: float | None
    late_ms: float
    missed_ticks: int
    compute_ms: float
    policy_ms: float
    mocap_age_ms: float | None
    pressure_age_ms: float | None
    rail_age_ms: float | None


_STATE = TypeAdapter(State)


def channels() -> tuple[Channel, ...]:
    """Return the channels that a converter adds to those of the log."""
    kinds = {
        **dict.fromkeys((FIXED, FRAMES), "FrameTransforms"),
        **dict.fromkeys((ROBOT, TARGET, SHELF, TRAIL), "SceneUpdate"),
        JOURNAL: "Log",
    }
    state = Channel(STATE, "softarm.State", plain(json.dumps(_STATE.json_schema(mode="serialization")).encode()))
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
                yield LogMessage(STATE, at_ns, at_ns, _STATE.dump_json(self._state(one), exclude_none=True))

    def journal(self, entry: Entry) -> LogMessage:
        """Something that happened, as foxglove.Log."""
        at_ns = entry.t_ns + self._offset_ns
        refused = entry.accepted is False
        level = ERROR if entry.kind == "stop" else WARNING if refused or entry.kind in ("lost", "event") else INFO
        text = {"timestamp": scene.time_of(at_ns), "level": level, "message": entry.text, "name": entry.kind}
        return LogMessage(JOURNAL, at_ns, at_ns, _json(text | {"file": "", "line": 0}))

    def _goes_on(self, frame: MocapFrame, seen_ns: int) -> bool:
        """Return whether the trail of the tip has a new point."""
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
        out, goal, seen = tick.outputs, tick.outputs.goal.goal, tick.outputs.observed
        values = seen.values if seen else None
        y_m, z_m = (_number(goal.y_m), _number(goal.z_m)) if goal else (None, None)
        tip_y_m, tip_z_m = (_number(values.tip_y_m), _number(values.tip_z_m)) if values else (None, None)
        known = tip_y_m is not None and tip_z_m is not None and y_m is not None and z_m is not None
        requested = out.action or (None, None)
        pressure, rail = self._pressure, self._rail
        return State(
            tick=out.tick,
            mode=out.mode,
            estop=out.estop,
            policy=out.policy,
            goal_state=out.goal.state,
            events=" ".join(event.name for event in out.events),
            clamps=" ".join(out.clamps),
            enabled=out.sent.enable,
            target_y_m=y_m,
            target_z_m=z_m,
            tip_y_m=tip_y_m,
            tip_z_m=tip_z_m,
            tip_to_target_m=math.hypot(tip_y_m - y_m, tip_z_m - z_m) if known else None,  # type: ignore[operator]
            cart_position_m=_number(values.cart_position_m) if values else None,
            cart_velocity_m_s=_number(values.cart_velocity_m_s) if values else None,
            cart_velocity_requested_m_s=_number(requested[0]),
            cart_velocity_sent_m_s=out.sent.cart_velocity_m_s,
            rail_position_m=_number(rail.position_m) if rail else None,
            rail_velocity_m_s=_number(rail.velocity_m_s) if rail else None,
            pressure_requested_kpa=_number(requested[1]),
            pressure_sent_kpa=out.sent.pressure_kpa,
            pressure_measured_kpa=_number(pressure.pressure_kpa) if pressure else None,
            late_ms=out.late_ns * 1e-6,
            missed_ticks=out.missed,
            compute_ms=tick.timing.compute_ns * 1e-6,
            policy_ms=out.policy_ns * 1e-6,
            mocap_age_ms=seen.mocap_age_ns * 1e-6 if seen else None,
            pressure_age_ms=seen.pressure_age_ns * 1e-6 if seen else None,
            rail_age_ms=seen.rail_age_ns * 1e-6 if seen else None,
        )


def _number(value: float | None) -> float | None:
    """Return a number, or None for NaN, which JSON does not have."""
    return value if value is not None and math.isfinite(value) else None


def _json(value: Any) -> bytes:
    return json.dumps(value, separators=(",", ":"), allow_nan=False).encode()
