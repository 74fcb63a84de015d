"""Event history of the daemon's run: each entry is a line in the journal, the newest are kept.

The recorder's thread writes it; other threads read immutable tuples.
"""

import logging
from bisect import bisect_left
from collections.abc import Callable
from datetime import UTC, datetime

from softarm.daemon.control.records import Inputs, Outputs
from softarm.daemon.logbook.changes import Changes
from softarm.schemas.events import Entry, EventKind

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

    def after(self, since: int | None, limit: int) -> tuple[Entry, ...]:
        """Return the `limit` oldest entries after number `since`, or the newest if `since` is None."""
        entries = self.entries
        if since is None:
            return entries[-limit:]
        return tuple(entry for entry in entries if entry.number > since)[:limit]


def utc(wall_ns: int) -> datetime:
    """Return a stamp of the wall clock as UTC, to the microsecond."""
    return datetime.fromtimestamp(wall_ns // 1_000_000_000, UTC).replace(microsecond=wall_ns % 1_000_000_000 // 1000)
