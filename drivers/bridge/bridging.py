"""What a bridge does with each frame: into the robot's plane, to the daemon; and what it says of it."""

import re
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple, Protocol

from softarm.common import yaml_lines
from softarm.common.yaml_schema import fit
from softarm.drivers.bridge.conversation import Conversation, Taken
from softarm.drivers.bridge.frame import Seen, View
from softarm.drivers.mocap import payload
from softarm.schemas.bridge import Bridge
from softarm.schemas.messages import BODY_NAMES

WINDOW_NS = 1_000_000_000  # of rate and age
LOST_NS = 500_000_000  # a body is said to be lost after so long; what flickers is told by the minute
MINUTE_NS = 60_000_000_000
PROBLEM_NS = 1_000_000_000  # what is over sooner is told by the minute, too
FINE = ("frames", "sent")
WORDS = {
    "gaps": "that the server counted never came",
    "malformed": "datagrams malformed",
    "overtaken": "no newer than the one before",
    "ahead": "stamped later than they came",
    "early": "before the clocks were known",
    "replayed": "of a recording",
    "unstamped": "without a stamp",
    "strangers": "datagrams from elsewhere",
    "unheard": "that no daemon heard",
}


def read(path: Path | str) -> Bridge:
    """Read bridge.yaml. Raises `softarm.common.yaml_lines.FileError` with all that is wrong with it."""
    return fit(yaml_lines.read(path, "`softarm bridge calibrate` writes one"), Bridge)


_FIGURES = re.compile(r"[-+0-9.]+")


class Outlet(Protocol):
    """Where frames go: `softarm.drivers.bridge.publisher.Publisher`."""

    sent: int
    unheard: int
    is_heard: bool

    def put(self, frame: bytes) -> None:
        """Take a frame."""


class Inlet(Protocol):
    """Where frames come from: `softarm.drivers.bridge.client.Client`."""

    conversation: Conversation
    strangers: int

    def poll(self, seconds: float) -> list[Taken]:
        """See `Client.poll`."""

    def problem(self) -> str | None:
        """See `Client.problem`."""


class Status(NamedTuple):
    """How it goes, over the last second."""

    rate_hz: float
    age_ms: float | None  # of the frames when they came, in the middle
    lost: tuple[str, ...]
    clock_offset_s: float | None
    clock_uncertainty_ms: float | None
    clock_drift_ppm: float | None
    stamped_by: str | None
    is_heard: bool
    problem: str | None
    counts: dict[str, int]

    def line(self) -> str:
        """For a terminal."""
        parts = [f"{self.rate_hz:.1f} frames/s"]
        if self.age_ms is not None:
            parts.append(f"{self.age_ms:.1f} ms old")
            parts.append(f"lost: {', '.join(self.lost)}" if self.lost else "all bodies seen")
        if self.clock_offset_s is not None:
            apart = f"{self.clock_offset_s:+.3f} s +- {self.clock_uncertainty_ms:.2f} ms"
            parts.append(f"clock {apart}, {self.clock_drift_ppm:+.1f} ppm")
        parts.append("the daemon hears" if self.is_heard else "no daemon hears")
        return " | ".join([*parts, *([self.problem] if self.problem else [])])


class Bridging:
    """A camera system's frames on their way. `step` moves them; `tell` hears a line when something changes."""

    def __init__(
        self,
        config: Bridge,
        inlet: Inlet,
        outlet: Outlet,
        tell: Callable[[str], None],
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._config, self._inlet, self._outlet, self._tell, self._clock = config, inlet, outlet, tell, clock
        self._view = View(config.room, config.bodies)
        self._unnamed: tuple[str, ...] = ()
        self._recent: deque[tuple[int, int]] = deque()  # arrival, age
        self._lost = {name: _Lost() for name in BODY_NAMES if getattr(config.bodies, name) is not None}
        self._problem = _Problem()
        self._minute = (clock(), self._figures())

    def step(self, seconds: float = 0.01) -> list[tuple[Taken, Seen]]:
        """Wait so long for frames, and hand on those that come; they are also returned."""
        done = []
        for taken in self._inlet.poll(seconds):
            names, self._unnamed = self._inlet.conversation.names_of(self._config.bodies)
            seen = self._view.of(taken.frame.bodies, names)
            self._outlet.put(payload.encode(taken.sequence, taken.t_capture_ns, seen.poses))
            self._note(taken, seen)
            done.append((taken, seen))
        self._journal()
        return done

    def status(self) -> Status:
        """How it goes now."""
        now_ns = self._clock()
        self._forget(now_ns)
        talk, ages = self._inlet.conversation, sorted(age for _, age in self._recent)
        clock = talk.clock if talk.clock is not None and talk.clock.is_ready else None
        return Status(
            rate_hz=len(ages) * 1e9 / WINDOW_NS,
            age_ms=ages[len(ages) // 2] / 1e6 if ages else None,
            lost=tuple(name for name, lost in self._lost.items() if not ages or lost.since_ns is not None),
            clock_offset_s=clock.offset_s if clock else None,
            clock_uncertainty_ms=1e3 * clock.uncertainty_s if clock else None,
            clock_drift_ppm=clock.drift_ppm if clock else None,
            stamped_by=talk.stamped_by,
            is_heard=self._outlet.is_heard,
            problem=self._inlet.problem() or self._nameless(),
            counts=self._figures(),
        )

    def _nameless(self) -> str | None:
        if not self._unnamed:
            return None
        missing, named = ", ".join(self._unnamed), _named(self._inlet.conversation.ids)
        return (
            f"{missing}: no such rigid body, the server names {named}; name it in Motive, or in bodies of bridge.yaml"
        )

    def _note(self, taken: Taken, seen: Seen) -> None:
        now_ns = taken.t_arrival_ns
        self._recent.append((now_ns, now_ns - taken.t_capture_ns))
        self._forget(now_ns)
        missing = set(seen.lost)
        for name, lost in self._lost.items():
            if (said := lost.see(name in missing, now_ns)) is not None:
                self._tell(f"{name} {said}")

    def _forget(self, now_ns: int) -> None:
        while self._recent and now_ns - self._recent[0][0] > WINDOW_NS:
            self._recent.popleft()

    def _figures(self) -> dict[str, int]:
        inlet, outlet = self._inlet, self._outlet
        figures = asdict(inlet.conversation.counts)
        return figures | {"strangers": inlet.strangers, "sent": outlet.sent, "unheard": outlet.unheard}

    def _journal(self) -> None:
        if (said := self._problem.see(self._inlet.problem() or self._nameless(), self._clock())) is not None:
            self._tell(said)
        now_ns, (then_ns, before) = self._clock(), self._minute
        if now_ns - then_ns < MINUTE_NS:
            return
        figures = self._figures()
        self._minute = (now_ns, figures)
        grown = {name: n - before[name] for name, n in figures.items() if n > before[name] and name not in FINE}
        frames = figures["frames"] - before["frames"]
        flickered = {name: lost.take() for name, lost in self._lost.items()}
        told = [f"{n} {WORDS[name]}" for name, n in grown.items()]
        told += [f"{name} lost in {100 * n / frames:.1f} %" for name, n in flickered.items() if n and frames]
        if told:
            self._tell(f"in the last minute: {frames} frames; {', '.join(told)}")


class _Problem:
    """What is wrong; figures in it may change with every frame."""

    def __init__(self) -> None:
        self._told: str | None = ""
        self._now: tuple[str | None, int] = (None, 0)

    def see(self, problem: str | None, now_ns: int) -> str | None:
        """Take notice; returns what is to be said."""
        about = None if problem is None else _FIGURES.sub("", problem)
        if about != self._now[0]:
            self._now = (about, now_ns)
        if about == self._told or (about is not None and now_ns - self._now[1] < PROBLEM_NS):
            return None
        self._told = about
        return problem or "frames come"


class _Lost:
    """Since when a body is not seen."""

    def __init__(self) -> None:
        self.since_ns: int | None = None
        self._said = False
        self._frames = 0

    def see(self, lost: bool, now_ns: int) -> str | None:
        """Take notice; returns what is to be said of it."""
        if not lost:
            since_ns, said = self.since_ns, self._said
            self.since_ns, self._said = None, False
            return f"is seen again, after {(now_ns - since_ns) / 1e9:.1f} s" if said and since_ns is not None else None
        self._frames += 1
        self.since_ns = now_ns if self.since_ns is None else self.since_ns
        if self._said or now_ns - self.since_ns < LOST_NS:
            return None
        self._said = True
        return "is lost"

    def take(self) -> int:
        """Frames without it since this was asked last."""
        frames, self._frames = self._frames, 0
        return frames


def _named(ids: dict[str, int]) -> str:
    return ", ".join(f"{name} ({number})" for name, number in sorted(ids.items())) or "none"
