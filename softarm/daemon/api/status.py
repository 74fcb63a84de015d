"""The robot's status for the API: the newest snapshot with ages, problems and versions."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from datetime import datetime
from typing import TYPE_CHECKING, Any

from pydantic import TypeAdapter

from softarm import __version__
from softarm.daemon.control.failsafe import ACKNOWLEDGE
from softarm.daemon.control.records import EStop, Outputs, Problems
from softarm.daemon.logbook.history import utc
from softarm.policies.registry import PolicyEntry
from softarm.schemas.base import Pair
from softarm.schemas.messages import MocapFrame
from softarm.schemas.policy import TrainingRange

if TYPE_CHECKING:
    from softarm.daemon.api.context import ApiContext
    from softarm.daemon.logbook.recorder import Recorder

POLL_S = 0.005  # between looks for a new snapshot
STALLED_NS = 200_000_000  # the control loop has stalled if the snapshot is older
_OUTPUTS = tuple(field.name for field in fields(Outputs))


@dataclass(frozen=True, slots=True)
class PolicyInfo:
    """Description of the policy in use."""

    name: str
    description: str
    trained: TrainingRange | None
    sha256: str | None
    shelf_depth_m: float | None = None  # depth of targets behind a shelf's front edge; null without a shelf


@dataclass(frozen=True, slots=True)
class Ages:
    """Ages of the newest readings at the start of the tick, ms; null before the first reading."""

    mocap: float | None = None
    pressure: float | None = None
    rail: float | None = None


@dataclass(frozen=True, slots=True)
class RecorderInfo:
    """State of the log recorder."""

    log: str | None  # path of the log being written
    dropped: int
    problem: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Status(Outputs):
    """The newest snapshot with ages, problems and versions; NaN and infinity are null."""

    time: float  # of the tick, Unix time in s
    stalled: bool  # True if the control loop no longer ticks, so all values are stale
    # y, z of each rigid body in m, in the order of `BODY_NAMES`, from the newest valid frame (`ages_ms.mocap`).
    # An untracked body is null; so is the whole before the first frame.
    bodies: tuple[Pair | None, ...] | None
    ages_ms: Ages
    problems: Problems
    policy_info: PolicyInfo | None
    recorder: RecorderInfo
    uptime_s: float
    version: str
    last_stop_at: datetime | None = None  # null before the first stop
    stop_port: int | None = None  # dedicated stop port of this host: POST /api/stop


@dataclass(frozen=True, slots=True, kw_only=True)
class RequestAnswer(Status):
    """The status after a request was carried out."""

    warnings: tuple[str, ...]  # doubts about a request that was accepted


_STATUS, _ANSWER = TypeAdapter(Status), TypeAdapter(RequestAnswer)


class StatusView:
    """Builds the status and encodes each snapshot once for all clients. Not thread-safe."""

    def __init__(self, context: "ApiContext", policies: Mapping[str, PolicyEntry]) -> None:
        self._context = context
        self._started_ns = context.clock()
        self._cached: tuple[Outputs | None, bool, bytes] = (None, False, b"")
        self.policies = policies  # as last listed

    def snapshot(self) -> Outputs | None:
        """Return the newest snapshot, or None before the first tick."""
        return self._context.snapshot()

    def age_ns(self, outputs: Outputs) -> int:
        """Return the time since the start of the snapshot's tick."""
        return self._context.clock() - outputs.t_ns

    def json(self) -> bytes | None:
        """Return the status as JSON, or None before the first tick."""
        outputs = self._context.snapshot()
        if outputs is None:
            return None
        stalled = self._stalled(outputs)
        known, was_stalled, data = self._cached
        if known is not outputs or was_stalled is not stalled:
            data = _STATUS.dump_json(Status(**self._parts(outputs, stalled)))
            self._cached = (outputs, stalled, data)
        return data

    def answer(self, warnings: tuple[str, ...]) -> bytes | None:
        """Return the answer to a request that was carried out as JSON, or None before the first tick."""
        outputs = self._context.snapshot()
        if outputs is None:
            return None
        return _ANSWER.dump_json(RequestAnswer(**self._parts(outputs, self._stalled(outputs)), warnings=warnings))

    def _stalled(self, outputs: Outputs) -> bool:
        return self.age_ns(outputs) > STALLED_NS

    def _parts(self, outputs: Outputs, stalled: bool) -> dict[str, Any]:
        entry = self.policies.get(outputs.policy)
        spec = entry.spec if entry else None
        recorder, frame = self._context.recorder, self._context.frame()
        return {name: getattr(outputs, name) for name in _OUTPUTS} | {
            "time": self._wall_of(outputs.t_ns) * 1e-9,
            "stalled": stalled,
            "bodies": _bodies(frame),
            "ages_ms": _ages(outputs, frame),
            "problems": self._context.problems(),
            "policy_info": spec
            and PolicyInfo(spec.name, spec.description, spec.trained, spec.sha256, spec.shelf_depth_m),
            "recorder": _recorder_info(recorder),
            "uptime_s": (outputs.t_ns - self._started_ns) * 1e-9,
            "version": __version__,
            "last_stop_at": self._last_stop_at(outputs),
            "stop_port": self._context.stop_port(),
        }

    def _last_stop_at(self, outputs: Outputs) -> datetime | None:
        if outputs.last_stop is None:
            return None
        return self._context.left_at() if outputs.last_stop_ns is None else utc(self._wall_of(outputs.last_stop_ns))

    def _wall_of(self, t_ns: int) -> int:
        return self._context.wall_ns() + t_ns - self._context.clock()

    def why_unhealthy(self) -> list[str]:
        """Return every reason why the robot cannot be used now; empty if it can."""
        outputs = self._context.snapshot()
        if outputs is None:
            return ["the control loop has not ticked yet: wait a second, then check the service's log"]
        reasons = []
        age_ns = self.age_ns(outputs)
        if age_ns > STALLED_NS:
            reasons.append(
                f"the control loop has not ticked for {age_ns * 1e-9:.1f} s: check the service's log, then restart it"
            )
        problems = self._context.problems()
        for device in ("mocap", "regulator", "rail"):
            if (problem := getattr(problems, device)) is not None:
                reasons.append(f"{device}: {problem}")
        if outputs.estop is EStop.LATCHED:
            reasons.append(f"the emergency stop is latched: make sure that the arm is free, {ACKNOWLEDGE}")
        elif outputs.estop is EStop.ENGAGED:
            reasons.append(f"the emergency stop is engaged: remove its cause, {ACKNOWLEDGE}")
        reasons += [f"{event.name}: {event.text}" for event in outputs.events if event.response != "warn"]
        if self._context.recorder is not None and self._context.recorder.problem is not None:
            reasons.append(f"recorder: {self._context.recorder.problem}")
        return reasons


def _recorder_info(recorder: "Recorder | None") -> RecorderInfo:
    if recorder is None:
        return RecorderInfo(None, 0, None)
    return RecorderInfo(str(recorder.path) if recorder.path else None, recorder.dropped, recorder.problem)


def _ages(outputs: Outputs, frame: MocapFrame | None) -> Ages:
    """Return the ages of the tick's readings, or of motion capture alone before the first observation."""
    seen = outputs.observed
    if seen is not None:
        return Ages(seen.mocap_age_ns * 1e-6, seen.pressure_age_ns * 1e-6, seen.rail_age_ns * 1e-6)
    return Ages() if frame is None else Ages(max(0, outputs.t_ns - frame.t_capture_ns) * 1e-6)


def _bodies(frame: MocapFrame | None) -> tuple[Pair | None, ...] | None:
    if frame is None:
        return None
    is_tracked = (body.tracked and math.isfinite(body.y_m) and math.isfinite(body.z_m) for body in frame.bodies)
    bodies = zip(frame.bodies, is_tracked, strict=True)
    return tuple((body.y_m, body.z_m) if tracked else None for body, tracked in bodies)
