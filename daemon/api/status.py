"""What the API says of the robot: the newest snapshot, and what stands around it."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from datetime import datetime
from pathlib import Path
from typing import Any, Protocol

from pydantic import TypeAdapter

from softarm.daemon.control.records import EStop, Outputs, Problems
from softarm.daemon.logbook.history import utc
from softarm.policies.registry import PolicyEntry
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


@dataclass(frozen=True, slots=True)
class PolicyInfo:
    """The policy in use."""

    name: str
    description: str
    trained: TrainingRange | None
    sha256: str | None


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

    stalled: bool  # the control loop no longer ticks: everything here is old
    ages_ms: Ages
    problems: Problems
    policy_info: PolicyInfo | None
    recorder: RecorderInfo
    uptime_s: float
    version: str
    last_stop_at: datetime | None = None  # null: no stop yet, or one before this daemon began
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
    ) -> None:
        self._snapshot, self._problems, self._recorder = snapshot, problems, recorder
        self._clock, self._wall_ns = clock, wall_ns
        self._version = version
        self._stop_port = stop_port
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
        box, seen = self._recorder, outputs.observed
        return {name: getattr(outputs, name) for name in _OUTPUTS} | {
            "stalled": stalled,
            "ages_ms": Ages()
            if seen is None
            else Ages(seen.mocap_age_ns * 1e-6, seen.pressure_age_ns * 1e-6, seen.rail_age_ns * 1e-6),
            "problems": self._problems(),
            "policy_info": PolicyInfo(spec.name, spec.description, spec.trained, spec.sha256) if spec else None,
            "recorder": RecorderInfo(None, 0, None)
            if box is None
            else RecorderInfo(str(box.path) if box.path else None, box.dropped, box.problem),
            "uptime_s": (outputs.t_ns - self._started_ns) * 1e-9,
            "version": self._version,
            "last_stop_at": self._time_of(outputs.last_stop_ns),
            "stop_port": self._stop_port(),
        }

    def _time_of(self, t_ns: int | None) -> datetime | None:
        return None if t_ns is None else utc(self._wall_ns() + t_ns - self._clock())

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
