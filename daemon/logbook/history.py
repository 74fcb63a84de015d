"""What has happened since the daemon began: a line in the service's journal for each entry; the newest are kept.

Written by the recorder's thread; the others see immutable tuples.
"""

import logging
from collections.abc import Callable
from datetime import UTC, datetime

from softarm.daemon.control.records import Inputs, Outputs
from softarm.daemon.logbook.changes import Changes
from softarm.schemas.events import Entry

log = logging.getLogger("softarm.events")

KEPT = 1000
WARN = ("stop", "lost")  # what else is wrong says its response in its text


class History:
    """The newest entries of a run of the daemon."""

    def __init__(self, run: str, monotonic_ns: Callable[[], int], wall_ns: Callable[[], int]) -> None:
        """run: names it, so that a client sees when numbers begin anew. The clocks: where the wall's stands to ours."""
        self.run = run
        self.entries: tuple[Entry, ...] = ()  # oldest first
        self._changes = Changes(lambda t_ns: utc(t_ns + wall_ns() - monotonic_ns()))

    def take(self, inputs: Inputs, outputs: Outputs) -> list[Entry]:
        """One tick more: what happened in it, told and kept."""
        new = self._changes.take(inputs, outputs)
        if new:
            self.entries = (*self.entries, *new)[-KEPT:]
        for entry in new:
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
