"""Processing of each frame (into the robot's plane, to the daemon) and the bridge's status and log lines."""

import contextlib
import re
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

import zenoh

from softarm.common import yaml_lines
from softarm.common.yaml_schema import fit
from softarm.drivers.bridge.client import Client
from softarm.drivers.bridge.conversation import StampedFrame
from softarm.drivers.bridge.frame import View, number_of
from softarm.drivers.bridge.natnet import Body, Vector
from softarm.drivers.mocap import payload
from softarm.drivers.mocap.zenoh_session import ClientThread
from softarm.schemas.bridge import Bridge, Listener
from softarm.schemas.messages import BODY_NAMES, Pose

# Interval of the checks for a listening daemon.
CHECK_S = 0.5


class Publisher(ClientThread):
    """Publisher that never waits for the daemon, which may start later or restart."""

    def __init__(self, daemon: Listener, report: Callable[[str], None]) -> None:
        super().__init__(daemon.endpoint, "publisher")
        self.sent = self.without_daemon = 0
        self.daemon_listens = False
        self._daemon, self._report = daemon, report
        self._publisher: zenoh.Publisher | None = None

    def put(self, frame: bytes) -> None:
        """Publish a frame, or drop it."""
        publisher = self._publisher
        if publisher is None:
            self.without_daemon += 1
            return
        with contextlib.suppress(zenoh.ZError):
            publisher.put(frame)
        self.sent += self.daemon_listens
        self.without_daemon += not self.daemon_listens

    def _use(self, session: zenoh.Session) -> None:
        publisher = session.declare_publisher(
            self._daemon.key,
            encoding=zenoh.Encoding.APPLICATION_JSON.with_schema(payload.SCHEMA),
            congestion_control=zenoh.CongestionControl.DROP,
            express=True,
        )
        self._publisher = publisher
        while not self._stopping.is_set():
            listens = bool(publisher.matching_status.matching)  # type: ignore[attr-defined]  # its stub says bool
            if listens != self.daemon_listens:
                self.daemon_listens = listens
                self._report(
                    f"the daemon at {self._daemon.endpoint} {'listens' if listens else 'is gone; waiting for it'}"
                )
            self._stopping.wait(CHECK_S)
        self._publisher = None


# Window of rate and age.
WINDOW_NS = 1_000_000_000
# A body is reported as lost after so long; shorter dropouts are counted in the report of each minute.
LOST_NS = 500_000_000
MINUTE_NS = 60_000_000_000
# A problem is reported after so long; shorter ones are counted in the report of each minute.
PROBLEM_NS = 1_000_000_000
REGULAR = ("frames", "sent")
WORDS = {
    "gaps": "missing from the server's count",
    "malformed": "malformed datagrams",
    "overtaken": "not newer than the frame before",
    "ahead": "stamped after their arrival",
    "early": "before the clocks were compared",
    "replayed": "from a recording",
    "unstamped": "without a stamp",
    "strangers": "datagrams from other senders",
    "without_daemon": "without a listening daemon",
}


def read(path: Path | str) -> Bridge:
    """Read bridge.yaml. Raises `softarm.common.yaml_lines.FileError` with all problems of the file."""
    return fit(yaml_lines.read(path, "`softarm bridge calibrate` writes one"), Bridge)


_FIGURES = re.compile(r"[-+0-9.]+")


class NullOutlet:
    """Outlet that drops all frames."""

    sent = without_daemon = 0
    daemon_listens = False

    def put(self, frame: bytes) -> None:
        """Drop a frame without publishing."""


class Status(NamedTuple):
    """State of the bridge over the last second; `age_ms` is the median age of the frames on arrival."""

    rate_hz: float
    age_ms: float | None
    lost: tuple[str, ...]
    clock_offset_s: float | None
    clock_uncertainty_ms: float | None
    clock_drift_ppm: float | None
    stamped_by: str | None
    daemon_listens: bool
    problem: str | None
    counts: dict[str, int]

    def line(self) -> str:
        """Return one line for a terminal."""
        parts = [f"{self.rate_hz:.1f} frames/s"]
        if self.age_ms is not None:
            parts.append(f"{self.age_ms:.1f} ms old")
            parts.append(f"lost: {', '.join(self.lost)}" if self.lost else "all bodies tracked")
        if self.clock_offset_s is not None:
            apart = f"{self.clock_offset_s:+.3f} s +- {self.clock_uncertainty_ms:.2f} ms"
            parts.append(f"clock {apart}, {self.clock_drift_ppm:+.1f} ppm")
        parts.append("the daemon listens" if self.daemon_listens else "no daemon listens")
        return " | ".join([*parts, *([self.problem] if self.problem else [])])


class Bridging:
    """Bridge between a camera system and the daemon. `step` passes frames on; `report` receives a line per change."""

    def __init__(
        self,
        config: Bridge,
        inlet: Client,
        outlet: Publisher | NullOutlet,
        report: Callable[[str], None],
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._config, self._inlet, self._outlet, self._report, self._clock = config, inlet, outlet, report, clock
        self._view = View(config.room, config.bodies)
        self._unnamed: tuple[str, ...] = ()
        self._recent: deque[tuple[int, int]] = deque()
        self._lost = {name: _Lost() for name in config.bodies.used}
        self._problem = _Problem()
        self._minute = (clock(), self._figures())

    def step(self, seconds: float = 0.01) -> list[tuple[StampedFrame, tuple[Pose, ...]]]:
        """Wait for frames at most so many seconds, pass them to the daemon and return them with their poses."""
        done = []
        for taken in self._inlet.poll(seconds):
            names, self._unnamed = self._inlet.conversation.names_of(self._config.bodies)
            poses = self._view.of(taken.frame.bodies, names)
            self._outlet.put(payload.encode(taken.sequence, taken.t_capture_ns, poses))
            self._note(taken, poses)
            done.append((taken, poses))
        self._journal()
        return done

    def status(self) -> Status:
        """Return the present status."""
        now_ns = self._clock()
        self._forget(now_ns)
        conversation, ages = self._inlet.conversation, sorted(age for _, age in self._recent)
        clock = conversation.clock if conversation.clock is not None and conversation.clock.is_ready else None
        return Status(
            rate_hz=len(ages) * 1e9 / WINDOW_NS,
            age_ms=ages[len(ages) // 2] / 1e6 if ages else None,
            lost=tuple(name for name, lost in self._lost.items() if not ages or lost.since_ns is not None),
            clock_offset_s=clock.offset_s if clock else None,
            clock_uncertainty_ms=1e3 * clock.uncertainty_s if clock else None,
            clock_drift_ppm=clock.drift_ppm if clock else None,
            stamped_by=conversation.stamped_by,
            daemon_listens=self._outlet.daemon_listens,
            problem=self._inlet.problem() or self._nameless(),
            counts=self._figures(),
        )

    def _nameless(self) -> str | None:
        if not self._unnamed:
            return None
        named = ", ".join(f"{name} ({number})" for name, number in sorted(self._inlet.conversation.ids.items()))
        problem = f"{', '.join(self._unnamed)}: no such rigid body, the server streams {named or 'none'}"
        return f"{problem}; rename it in Motive, or in bodies of bridge.yaml"

    def _note(self, taken: StampedFrame, poses: tuple[Pose, ...]) -> None:
        now_ns = taken.t_arrival_ns
        self._recent.append((now_ns, now_ns - taken.t_capture_ns))
        self._forget(now_ns)
        tracked = {name: pose.tracked for name, pose in zip(BODY_NAMES, poses, strict=True)}
        for name, lost in self._lost.items():
            if (change := lost.update(not tracked[name], now_ns)) is not None:
                self._report(f"{name} {change}")

    def _forget(self, now_ns: int) -> None:
        while self._recent and now_ns - self._recent[0][0] > WINDOW_NS:
            self._recent.popleft()

    def _figures(self) -> dict[str, int]:
        inlet, outlet = self._inlet, self._outlet
        figures = asdict(inlet.conversation.counts) | {"strangers": inlet.other_senders}
        return figures | {"sent": outlet.sent, "without_daemon": outlet.without_daemon}

    def _journal(self) -> None:
        if (change := self._problem.update(self._inlet.problem() or self._nameless(), self._clock())) is not None:
            self._report(change)
        now_ns, (then_ns, before) = self._clock(), self._minute
        if now_ns - then_ns < MINUTE_NS:
            return
        figures = self._figures()
        self._minute = (now_ns, figures)
        grown = {name: n - before[name] for name, n in figures.items() if n > before[name] and name not in REGULAR}
        frames = figures["frames"] - before["frames"]
        flickered = {name: lost.take_count() for name, lost in self._lost.items()}
        parts = [f"{n} {WORDS[name]}" for name, n in grown.items()]
        parts += [f"{name} lost in {100 * n / frames:.1f} %" for name, n in flickered.items() if n and frames]
        if parts:
            self._report(f"in the last minute: {frames} frames; {', '.join(parts)}")


class _Problem:
    """Present problem; a change of its numbers alone is not reported."""

    def __init__(self) -> None:
        self._reported: str | None = ""
        self._now: tuple[str | None, int] = (None, 0)

    def update(self, problem: str | None, now_ns: int) -> str | None:
        """Return the line to report, or None."""
        about = None if problem is None else _FIGURES.sub("", problem)
        if about != self._now[0]:
            self._now = (about, now_ns)
        if about == self._reported or (about is not None and now_ns - self._now[1] < PROBLEM_NS):
            return None
        self._reported = about
        return problem or "frames arrive"


class _Lost:
    """Dropout of one body."""

    def __init__(self) -> None:
        self.since_ns: int | None = None
        self._is_reported = False
        self._frames = 0

    def update(self, lost: bool, now_ns: int) -> str | None:
        """Return the change to report, or None."""
        if not lost:
            since_ns, was_reported = self.since_ns, self._is_reported
            self.since_ns, self._is_reported = None, False
            if since_ns is None or not was_reported:
                return None
            return f"is tracked again, after {(now_ns - since_ns) / 1e9:.1f} s"
        self._frames += 1
        self.since_ns = now_ns if self.since_ns is None else self.since_ns
        if self._is_reported or now_ns - self.since_ns < LOST_NS:
            return None
        self._is_reported = True
        return "is lost"

    def take_count(self) -> int:
        """Return the number of frames without the body since the last call."""
        frames, self._frames = self._frames, 0
        return frames


LOOK_NS = 1_000_000_000
# A frame without these bodies is not usable.
NEEDED = ("cart", "link5")


class Row(NamedTuple):
    """One rigid body. `body` is empty if it is not part of the arm; `seen` is its share of the frames."""

    body: str
    rigid_body: str
    id: int | None
    seen: float
    room_m: Vector | None
    pose: tuple[float, float, float] | None


class Found(NamedTuple):
    """Result of an inspection; `problem` is why the daemon cannot use the stream."""

    rows: list[Row]
    status: Status
    problem: str | None


def look_at(config: Bridge, inlet: Client, patience_s: float) -> Found:
    """Inspect the stream for a second after the first frame, which may take up to `patience_s`."""
    bridging = Bridging(config, inlet, NullOutlet(), lambda text: None)
    until_ns = time.monotonic_ns() + round(patience_s * 1e9)
    counted: dict[int, int] = {}
    newest: dict[int, Body] = {}
    poses: dict[str, Pose] = {}
    frames = 0
    while time.monotonic_ns() < until_ns:
        for taken, seen in bridging.step():
            if frames == 0:
                until_ns = time.monotonic_ns() + LOOK_NS
            frames += 1
            for body in taken.frame.bodies:
                counted[body.id] = counted.get(body.id, 0) + body.tracked
                newest |= {body.id: body} if body.tracked or body.id not in newest else {}
            poses |= {name: pose for name, pose in zip(BODY_NAMES, seen, strict=True) if pose.tracked}
    rows = list(_rows(config, inlet, newest, {number: n / frames for number, n in counted.items()}, poses))
    return Found(rows, bridging.status(), _problem(bridging.status(), frames, poses))


def _rows(
    config: Bridge, inlet: Client, newest: dict[int, Body], seen: dict[int, float], poses: dict[str, Pose]
) -> list[Row]:
    ids = inlet.conversation.ids
    names = {number: name for name, number in ids.items()}
    rows, used = [], set()
    for name, mark in config.bodies.used.items():
        number = number_of(name, mark, ids)
        used.add(number)
        share = seen.get(number, 0.0) if number is not None else 0.0
        body = newest[number] if number is not None and share else None
        pose = poses[name][:3] if name in poses else None
        shown = names.get(mark.rigid_body, "") if isinstance(mark.rigid_body, int) else mark.rigid_body or name
        rows.append(Row(name, shown, number, share, body.position_m if body else None, pose))
    for number in sorted(newest.keys() - used):
        place = newest[number].position_m if seen[number] else None
        rows.append(Row("", names.get(number, ""), number, seen[number], place, None))
    return rows


def _problem(status: Status, frames: int, poses: dict[str, Pose]) -> str | None:
    if not frames:
        return status.problem or "no frames arrived"
    unseen = [name for name in NEEDED if name not in poses]
    if unseen:
        remedy = "name them in Motive, or in bodies of bridge.yaml, and bring them into view"
        return status.problem or f"{' and '.join(unseen)} not tracked: the daemon needs these bodies; {remedy}"
    return None
