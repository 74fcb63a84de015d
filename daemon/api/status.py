"""What the API says of the robot: the newest snapshot, and what stands around it."""

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from datetime import datetime
from pathlib import Path
from typing import Any, Protocol

from pydantic import TypeAdapter

from softarm.daemon.control.records import EStop, Outputs, Problems
from softarm.daemon.logbook.history import utc
from softarm.policies.base import PolicySpec
from softarm.policies.registry import PolicyEntry
from softarm.schemas.messages import MocapFrame
from softarm.schemas.policy import TrainingRange

STALLED_NS = 200_000_000  # a snapshot older than this: the control loop does not tick
_OUTPUTS = tuple(field.name for field in fields(Outputs))


class RecorderState(Protocol):
    """What the API shows of the recorder."""

    path: Path | None
    problem: str | None

    @property
    def dropped(self) -> int:
        """Ticks that could not be kept."""

    def done(self, what: str, text: str, who: str) -> None:
        """Note that somebody had something done beside the control loop. Never blocks."""


@dataclass(frozen=True, slots=True)
class PolicyInfo:
    """The policy in use."""

    name: str
    description: str
    trained: TrainingRange | None
    sha256: str | None
    shelf_depth_m: float | None = None  # that targets lie behind a shelf's front edge; null: it flies without a shelf


@dataclass(frozen=True, slots=True)
class Ages:
    """How old the newest readings were when the tick began, ms; null before the first."""

    mocap: float | None = None
    pressure: float | None = None
    rail: float | None = None


@dataclass(frozen=True, slots=True)
class RecorderInfo:
    """The black box."""

    log: str | None  # path of the log being written
    dropped: int
    problem: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Status(Outputs):
    """The newest snapshot with what a person at the bench wants beside it; NaN is null."""

    time: float  # of the tick, seconds of Unix' time
    stalled: bool  # the control loop no longer ticks: everything here is old
    # y, z of each rigid body as motion capture sees it, in the order of `BODY_NAMES`: of the newest good frame, as old
    # as `ages_ms.mocap` says. A body that is not seen is null; so is all of it before the first frame.
    bodies: tuple[tuple[float, float] | None, ...] | None
    ages_ms: Ages
    problems: Problems
    policy_info: PolicyInfo | None
    recorder: RecorderInfo
    uptime_s: float
    version: str
    last_stop_at: datetime | None = None  # null: no stop yet, or one that an older version left without its time
    stop_port: int | None = None  # of this host, where POST /api/stop waits for nobody


@dataclass(frozen=True, slots=True, kw_only=True)
class RequestAnswer(Status):
    """The status once a request was carried out."""

    warnings: tuple[str, ...]  # what a person should know of a request that was taken all the same


_STATUS, _ANSWER = TypeAdapter(Status), TypeAdapter(RequestAnswer)


class StatusView:
    """Makes the status, and encodes each snapshot once however many clients ask. For one thread."""

    def __init__(
        self,
        snapshot: Callable[[], Outputs | None],
        problems: Callable[[], Problems],
        recorder: RecorderState | None,
        policies: Mapping[str, PolicyEntry],
        clock: Callable[[], int],
        version: str,
        stop_port: Callable[[], int | None] = lambda: None,
        wall_ns: Callable[[], int] = time.time_ns,
        frame: Callable[[], MocapFrame | None] = lambda: None,
        left_at: Callable[[], datetime | None] = lambda: None,
    ) -> None:
        """frame: the newest good one. left_at: when the stop was that the daemon before this one left."""
        self._snapshot, self._problems, self._recorder = snapshot, problems, recorder
        self._clock, self._wall_ns = clock, wall_ns
        self._version = version
        self._stop_port, self._frame, self._left_at = stop_port, frame, left_at
        self._started_ns = clock()
        self._cached: tuple[Outputs | None, bool, bytes] = (None, False, b"")
        self.policies = policies  # as they were last looked up

    def snapshot(self) -> Outputs | None:
        """The newest one; None before the first tick."""
        return self._snapshot()

    def age_ns(self, outputs: Outputs) -> int:
        """Since the snapshot's tick began."""
        return self._clock() - outputs.t_ns

    def json(self) -> bytes | None:
        """The status as JSON; None before the first tick."""
        outputs = self._snapshot()
        if outputs is None:
            return None
        stalled = self._stalled(outputs)
        known, was_stalled, data = self._cached
        if known is not outputs or was_stalled is not stalled:
            data = _STATUS.dump_json(Status(**self._parts(outputs, stalled)))
            self._cached = (outputs, stalled, data)
        return data

    def answer(self, warnings: tuple[str, ...]) -> bytes | None:
        """The answer to a request that was carried out, as JSON; None before the first tick."""
        outputs = self._snapshot()
        if outputs is None:
            return None
        return _ANSWER.dump_json(RequestAnswer(**self._parts(outputs, self._stalled(outputs)), warnings=warnings))

    def _stalled(self, outputs: Outputs) -> bool:
        return self.age_ns(outputs) > STALLED_NS

    def _parts(self, outputs: Outputs, stalled: bool) -> dict[str, Any]:
        entry = self.policies.get(outputs.policy)
        spec = entry.spec if entry else None
        box, frame = self._recorder, self._frame()
        return {name: getattr(outputs, name) for name in _OUTPUTS} | {
            "time": self._wall_of(outputs.t_ns) * 1e-9,
            "stalled": stalled,
            "bodies": _bodies(frame),
            "ages_ms": _ages(outputs, frame),
            "problems": self._problems(),
            "policy_info": _policy_info(spec) if spec else None,
            "recorder": RecorderInfo(None, 0, None)
            if box is None
            else RecorderInfo(str(box.path) if box.path else None, box.dropped, box.problem),
            "uptime_s": (outputs.t_ns - self._started_ns) * 1e-9,
            "version": self._version,
            "last_stop_at": self._last_stop_at(outputs),
            "stop_port": self._stop_port(),
        }

    def _last_stop_at(self, outputs: Outputs) -> datetime | None:
        if outputs.last_stop is None:
            return None
        return self._left_at() if outputs.last_stop_ns is None else utc(self._wall_of(outputs.last_stop_ns))

    def _wall_of(self, t_ns: int) -> int:
        return self._wall_ns() + t_ns - self._clock()

    def why_unhealthy(self) -> list[str]:
        """Every reason for which the robot cannot be used now; empty when it can."""
        outputs = self._snapshot()
        if outputs is None:
            return ["the control loop has not ticked yet: wait a second, then look at the service's log"]
        reasons = []
        age_ns = self.age_ns(outputs)
        if age_ns > STALLED_NS:
            reasons.append(
                f"the control loop has not ticked for {age_ns * 1e-9:.1f} s: look at the service's log, then restart it"
            )
        problems = self._problems()
        for device in ("mocap", "regulator", "rail"):
            if (problem := getattr(problems, device)) is not None:
                reasons.append(f"{device}: {problem}")
        if outputs.estop is EStop.LATCHED:
            reasons.append("the emergency stop is latched: POST /api/acknowledge")
        elif outputs.estop is EStop.ENGAGED:
            reasons.append("the emergency stop is engaged: remove its cause, then POST /api/acknowledge")
        reasons += [f"{event.name}: {event.text}" for event in outputs.events if event.response != "warn"]
        if self._recorder is not None and self._recorder.problem is not None:
            reasons.append(f"recorder: {self._recorder.problem}")
        return reasons


def _policy_info(spec: PolicySpec) -> PolicyInfo:
    return PolicyInfo(spec.name, spec.description, spec.trained, spec.sha256, spec.shelf_depth_m)


def _ages(outputs: Outputs, frame: MocapFrame | None) -> Ages:
    """Of what the tick was fed; where it is fed nothing yet, of the cameras all the same."""
    seen = outputs.observed
    if seen is not None:
        return Ages(seen.mocap_age_ns * 1e-6, seen.pressure_age_ns * 1e-6, seen.rail_age_ns * 1e-6)
    return Ages() if frame is None else Ages(max(0, outputs.t_ns - frame.t_capture_ns) * 1e-6)


def _bodies(frame: MocapFrame | None) -> tuple[tuple[float, float] | None, ...] | None:
    if frame is None:
        return None
    is_seen = (body.tracked and math.isfinite(body.y_m) and math.isfinite(body.z_m) for body in frame.bodies)
    return tuple((body.y_m, body.z_m) if seen else None for body, seen in zip(frame.bodies, is_seen, strict=True))
