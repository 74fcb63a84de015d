"""Event history of the daemon's run: each entry is a line in the journal, the newest are kept.

`Changes` derives the events from consecutive ticks. Hysteresis keeps flickering states to one event: a device counts as
found, and an event as over, after a while.

The recorder's thread writes it; other threads read immutable tuples.
"""

import logging
from bisect import bisect_left
from collections.abc import Callable, Iterator
from datetime import UTC, datetime

from softarm.daemon.control.records import Inputs, Mode, Outputs, Request
from softarm.schemas.events import Entry, EventKind

# Events of the failsafe table that report a device without answer.
LOST = {
    "mocap_missing": "mocap",
    "mocap_stale": "mocap",
    "pressure_missing": "regulator",
    "pressure_stale": "regulator",
    "rail_missing": "rail",
    "rail_stale": "rail",
    "rail_link_lost": "rail",
}
REPORTED_BY_STOP = ("stop_requested",)  # the entry of the stop reports it already
FOUND_NS = 1_000_000_000  # a device counts as found after answering this long
OVER_NS = 10_000_000_000  # an event counts as over after this long
LISTED = 10  # requests per second with an entry each; the rest is counted


class Changes:
    """Derives events from ticks in their order."""

    def __init__(self, time_of: Callable[[int], datetime]) -> None:
        """Start without a previous tick; `time_of` converts a stamp of CLOCK_MONOTONIC, ns, to UTC."""
        self._time_of = time_of
        self._before: Outputs | None = None
        self._lost: dict[str, tuple[int, int]] = {}  # device -> first and last tick without answer, ns
        self._held: dict[str, int] = {}  # event -> last tick in which it held, ns
        self._second_ns, self._requested = 0, 0  # start of the present second, requests in it
        self._number = 0

    def take(self, inputs: Inputs, outputs: Outputs) -> list[Entry]:
        """Return the events of one tick: requests, mode and goal, devices, then failsafe events."""
        groups = (self._requests(inputs, outputs), self._mode(inputs, outputs), self._devices(outputs))
        at = outputs.t_ns, outputs.tick
        found = [self._entry(*at, *event) for group in (*groups, self._events(outputs)) for event in group]
        self._before = outputs
        return found

    def done(self, t_ns: int, what: str, text: str, who: str) -> Entry:
        """Return the event of an action outside the control loop, such as a deleted log."""
        tick = self._before.tick if self._before else 0
        return self._entry(t_ns, tick, "request", what, text + _source(who), who or None, True)

    def _entry(
        self,
        t_ns: int,
        tick: int,
        kind: EventKind,
        what: str,
        text: str,
        who: str | None = None,
        accepted: bool | None = None,
    ) -> Entry:
        self._number += 1
        text = text.encode(errors="replace").decode()  # a device's text may be invalid UTF-8
        return Entry(self._number, t_ns, self._time_of(t_ns), tick, kind, what, text, who, accepted)

    def _requests(self, inputs: Inputs, outputs: Outputs) -> Iterator[tuple[EventKind, str, str, str | None, bool]]:
        if outputs.t_ns - self._second_ns >= 1_000_000_000:
            if self._requested > LISTED:
                yield "request", "more", f"{self._requested - LISTED} more requests within a second", None, True
            self._requested = 0
        results = {result.number: result for result in outputs.results}
        for request in inputs.requests:
            self._second_ns = self._second_ns if self._requested else outputs.t_ns
            self._requested += 1
            result = results.get(request.number)
            accepted = result is not None and result.accepted
            reasons = ("the control loop has failed",) if result is None else result.reasons
            answer = "" if accepted else f"; refused: {'; '.join(reasons)}"
            if self._requested <= LISTED:
                text = f"{_described(request)}{_source(request.who)}{answer}"
                yield "request", request.kind, text, request.who or None, accepted

    def _mode(self, inputs: Inputs, outputs: Outputs) -> Iterator[tuple[EventKind, str, str, str | None]]:
        before = self._before
        began = Mode.DISARMED if outputs.tick <= 1 else outputs.mode  # a log may start in the middle of a run
        was = before.mode if before else began
        if outputs.mode is not was:
            source = next((request.who for request in inputs.requests if request.kind == "stop"), None) or None
            stopped = outputs.mode in (Mode.STOPPED, Mode.STOPPING) or outputs.last_stop_ns == outputs.t_ns
            why = f": {outputs.last_stop}" if stopped else ""
            if outputs.mode is Mode.STOPPED:
                left = " before this daemon started" if before is None and outputs.last_stop_ns is None else ""
                yield "stop", outputs.mode, f"emergency stop{left}{why}", source
            else:
                yield "mode", outputs.mode, f"{was} → {outputs.mode}{why}", None
        goal = outputs.goal
        was_running = before is not None and before.goal.number == goal.number and before.goal.state == "running"
        if was_running and goal.state != "running":
            reason = f" ({goal.reason})" if goal.reason else ""
            yield "goal", goal.state, f"goal {goal.number} {goal.state}{reason} after {goal.time_s:.1f} s", None

    def _devices(self, outputs: Outputs) -> Iterator[tuple[EventKind, str, str]]:
        now = outputs.t_ns
        for event in outputs.events:
            if (device := LOST.get(event.name)) is None:
                continue
            if device not in self._lost and self._before is not None:  # in the first tick no device was connected yet
                yield "lost", device, f"{device} lost: {event.text}"
            self._lost[device] = self._lost.get(device, (now, now))[0], now
        for device, (since, last) in tuple(self._lost.items()):
            if now - last >= FOUND_NS:
                del self._lost[device]
                yield "found", device, f"{device} found after {(last - since) * 1e-9:.1f} s"

    def _events(self, outputs: Outputs) -> Iterator[tuple[EventKind, str, str]]:
        now = outputs.t_ns
        for event in outputs.events:
            if event.name in LOST or event.name in REPORTED_BY_STOP:
                continue
            if now - self._held.get(event.name, now - OVER_NS) >= OVER_NS:
                yield "event", event.name, f"{event.name} ({event.response}): {event.text}"
            self._held[event.name] = now


def _source(who: str) -> str:
    return f" requested from {who}" if who else ""


def _described(request: Request) -> str:
    goal = request.goal
    if goal is not None:
        return f"goal {goal.kind}" + (f" y {goal.y_m:g}, z {goal.z_m:g} m" if goal.kind == "reach" else "")
    return f"policy {request.policy}" if request.policy else request.kind.replace("_", " ")


log = logging.getLogger("softarm.events")

KEPT = 1000
LATE_NS = (100_000, 300_000, 1_000_000, 3_000_000, 10_000_000, 33_000_000)  # upper bounds of the histogram's bins
WARN = ("stop", "lost")  # logged as warnings


class History:
    """Newest entries of the daemon's present run."""

    def __init__(self, run: str, monotonic_ns: Callable[[], int], wall_ns: Callable[[], int]) -> None:
        """Start an empty history; the clocks return CLOCK_MONOTONIC and Unix time."""
        self.run = run  # clients detect a restart by it
        self.entries: tuple[Entry, ...] = ()  # oldest first
        self.counts: dict[tuple[EventKind, str], int] = {}  # (kind, what) -> number since the start
        self.lateness = [0] * (len(LATE_NS) + 1)  # ticks per bin, the last bin without upper bound
        self.late_ns = 0  # sum of all ticks
        self._changes = Changes(lambda t_ns: utc(t_ns + wall_ns() - monotonic_ns()))

    def take(self, inputs: Inputs, outputs: Outputs) -> list[Entry]:
        """Log, keep and return the events of a tick."""
        self.lateness[bisect_left(LATE_NS, outputs.late_ns)] += 1
        self.late_ns += outputs.late_ns
        return self._add(self._changes.take(inputs, outputs))

    def done(self, t_ns: int, what: str, text: str, who: str) -> list[Entry]:
        """Log, keep and return the event of an action outside the control loop."""
        return self._add([self._changes.done(t_ns, what, text, who)])

    def _add(self, new: list[Entry]) -> list[Entry]:
        if new:
            self.entries = (*self.entries, *new)[-KEPT:]
        for entry in new:
            key = entry.kind, entry.what
            self.counts = {**self.counts, key: self.counts.get(key, 0) + 1}  # a new dict: another thread may be reading
            log.log(logging.WARNING if entry.kind in WARN else logging.INFO, "%s", entry.text)
        return new


def utc(wall_ns: int) -> datetime:
    """Return a stamp of the wall clock as UTC, to the microsecond."""
    return datetime.fromtimestamp(wall_ns // 1_000_000_000, UTC).replace(microsecond=wall_ns % 1_000_000_000 // 1000)
