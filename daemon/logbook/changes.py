"""What happened from one tick to the next, read off what went in and what came out. Pure.

What flickers is told once: a device is found, and an event over, when that has lasted for a while.
"""

from collections.abc import Callable, Iterator
from datetime import datetime

from softarm.daemon.control.records import Inputs, Mode, Outputs, Request
from softarm.schemas.events import Entry, EventKind

LOST = {  # events of the failsafe table that say that a device does not answer
    "mocap_missing": "mocap",
    "mocap_stale": "mocap",
    "pressure_missing": "regulator",
    "pressure_stale": "regulator",
    "rail_missing": "rail",
    "rail_stale": "rail",
    "rail_link_lost": "rail",
}
TOLD_BY_MODE = ("stop_requested",)  # what the entry of the stop says already
FOUND_NS, OVER_NS = 1_000_000_000, 10_000_000_000  # so long a device has answered, an event has not held
LISTED = 10  # requests of one second, each with an entry of its own; what comes on top is counted


class Changes:
    """Takes every tick in its turn and gives back what happened in it."""

    def __init__(self, time_of: Callable[[int], datetime]) -> None:
        """time_of: a stamp of CLOCK_MONOTONIC, in UTC."""
        self._time_of = time_of
        self._before: Outputs | None = None
        self._lost: dict[str, tuple[int, int]] = {}  # device -> since, last
        self._held: dict[str, int] = {}  # event -> when it held last
        self._second_ns, self._asked = 0, 0  # requests since then
        self._number = 0

    def take(self, inputs: Inputs, outputs: Outputs) -> list[Entry]:
        """One tick more. In order: who asked, what the arm does for it, what was lost, what is wrong."""
        parts = (self._requests(inputs, outputs), self._mode(inputs, outputs), self._devices(outputs))
        at = outputs.t_ns, outputs.tick
        found = [self._entry(*at, *one) for part in (*parts, self._events(outputs)) for one in part]
        self._before = outputs
        return found

    def done(self, t_ns: int, what: str, text: str, who: str) -> Entry:
        """What somebody had done beside the control loop, which no tick shows."""
        by = f", asked for by {who}" if who else ""
        return self._entry(
            t_ns, self._before.tick if self._before else 0, "request", what, text + by, who or None, True
        )

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
        text = text.encode(errors="replace").decode()  # a device's complaint may be no text
        return Entry(self._number, t_ns, self._time_of(t_ns), tick, kind, what, text, who, accepted)

    def _requests(self, inputs: Inputs, outputs: Outputs) -> Iterator[tuple[EventKind, str, str, str | None, bool]]:
        if outputs.t_ns - self._second_ns >= 1_000_000_000:
            if self._asked > LISTED:
                yield "request", "more", f"{self._asked - LISTED} requests more within a second", None, True
            self._asked = 0
        results = {result.number: result for result in outputs.results}
        for request in inputs.requests:
            self._second_ns = self._second_ns if self._asked else outputs.t_ns
            self._asked += 1
            result = results.get(request.number)
            accepted = result is not None and result.accepted
            reasons = ("the control loop has failed",) if result is None else result.reasons
            answer = "" if accepted else f"; refused: {'; '.join(reasons)}"
            if self._asked <= LISTED:
                by = f", asked for by {request.who}" if request.who else ""
                yield "request", request.kind, f"{_wish(request)}{by}{answer}", request.who or None, accepted

    def _mode(self, inputs: Inputs, outputs: Outputs) -> Iterator[tuple[EventKind, str, str, str | None]]:
        before = self._before
        began = Mode.DISARMED if outputs.tick <= 1 else outputs.mode  # a log may begin in the middle of a run
        was = before.mode if before else began
        if outputs.mode is not was:
            asked = next((request.who for request in inputs.requests if request.kind == "stop"), None) or None
            stopped = outputs.mode in (Mode.STOPPED, Mode.STOPPING) or outputs.last_stop_ns == outputs.t_ns
            why = f": {outputs.last_stop}" if stopped else ""
            if outputs.mode is Mode.STOPPED:
                left = " before this daemon began" if before is None and outputs.last_stop_ns is None else ""
                yield "stop", outputs.mode, f"emergency stop{left}{why}", asked
            else:
                yield "mode", outputs.mode, f"{outputs.mode}, was {was}{why}", None
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
            if device not in self._lost and self._before is not None:  # in the first tick nothing was there to lose
                yield "lost", device, f"{device} lost: {event.text}"
            self._lost[device] = self._lost.get(device, (now, now))[0], now
        for device, (since, last) in tuple(self._lost.items()):
            if now - last >= FOUND_NS:
                del self._lost[device]
                yield "found", device, f"{device} found after {(last - since) * 1e-9:.1f} s"

    def _events(self, outputs: Outputs) -> Iterator[tuple[EventKind, str, str]]:
        now = outputs.t_ns
        for event in outputs.events:
            if event.name in LOST or event.name in TOLD_BY_MODE:
                continue
            if now - self._held.get(event.name, now - OVER_NS) >= OVER_NS:
                yield "event", event.name, f"{event.name} ({event.response}): {event.text}"
            self._held[event.name] = now


def _wish(request: Request) -> str:
    """What somebody asked for."""
    goal = request.goal
    if goal is not None:
        return f"goal {goal.kind}" + (f" y {goal.y_m:g}, z {goal.z_m:g} m" if goal.kind == "reach" else "")
    return f"policy {request.policy}" if request.policy else request.kind.replace("_", " ")
