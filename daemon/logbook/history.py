"""What has happened since the daemon began: a line in the service's journal for each entry; the newest are kept.

Written by the recorder's thread; the others see immutable tuples.
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
LATE_NS = (100_000, 300_000, 1_000_000, 3_000_000, 10_000_000, 33_000_000)  # classes of ticks: as late or less
WARN = ("stop", "lost")  # what else is wrong says its response in its text


class History:
    """The newest entries of a run of the daemon."""

    def __init__(self, run: str, monotonic_ns: Callable[[], int], wall_ns: Callable[[], int]) -> None:
        """run: names it, so that a client sees when numbers begin anew. The clocks: where the wall's stands to ours."""
        self.run = run
        self.entries: tuple[Entry, ...] = ()  # oldest first
        self.counts: dict[tuple[EventKind, str], int] = {}  # kind and what of an entry -> how many, since the start
        self.lateness = [0] * (len(LATE_NS) + 1)  # ticks of each class, the last one later than all
        self.late_ns = 0  # of all ticks
        self._changes = Changes(lambda t_ns: utc(t_ns + wall_ns() - monotonic_ns()))

    def take(self, inputs: Inputs, outputs: Outputs) -> list[Entry]:
        """One tick more: what happened in it, told and kept."""
        self.lateness[bisect_left(LATE_NS, outputs.late_ns)] += 1
        self.late_ns += outputs.late_ns
        return self._tell(self._changes.take(inputs, outputs))

    def done(self, t_ns: int, what: str, text: str, who: str) -> list[Entry]:
        """What somebody had done beside the control loop: told and kept like the rest."""
        return self._tell([self._changes.done(t_ns, what, text, who)])

    def _tell(self, new: list[Entry]) -> list[Entry]:
        if new:
            self.entries = (*self.entries, *new)[-KEPT:]
        for entry in new:
            key = entry.kind, entry.what
            self.counts = {**self.counts, key: self.counts.get(key, 0) + 1}  # another one: somebody may be reading
            log.log(logging.WARNING if entry.kind in WARN else logging.INFO, "%s", entry.text)
        return new

    def after(self, since: int | None, limit: int) -> tuple[Entry, ...]:
        """The `limit` oldest of those that came after the one numbered `since`; None: the newest."""
        entries = self.entries
        if since is None:
            return entries[-limit:]
        return tuple(entry for entry in entries if entry.number > since)[:limit]


def utc(wall_ns: int) -> datetime:
    """A stamp of the wall clock, to the microsecond."""
    return datetime.fromtimestamp(wall_ns // 1_000_000_000, UTC).replace(microsecond=wall_ns % 1_000_000_000 // 1000)
