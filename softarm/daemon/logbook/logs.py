"""Reads logs as ticks, also those of a killed daemon."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

from softarm.daemon.control.records import Inputs, Outputs, TickTiming
from softarm.daemon.logbook import ticks
from softarm.daemon.logbook.changes import Changes
from softarm.daemon.logbook.history import utc
from softarm.recordings import mcap_file
from softarm.recordings.channels import EVENT
from softarm.recordings.log_file import LogFile
from softarm.recordings.mcap_file import LogError
from softarm.schemas import log
from softarm.schemas.events import Entry


class TickLog(LogFile):
    """Log whose ticks are streamed from the file."""

    __slots__ = ()

    def __iter__(self) -> Iterator[tuple[Inputs, Outputs, TickTiming]]:
        """Every tick, as the control loop saw it.

        Raises LogError when a tick's own messages are not there (a log of another version, or edited).
        """
        joiner = ticks.Joiner()
        for topic, data in mcap_file.messages(self.path):
            try:
                tick = joiner.join(topic, data)
            except ValueError as error:
                raise LogError(
                    f"{self.path}: {error}; was the file edited, merged or written by another version? "
                    f"It says version {self.metadata.get(log.SOFTWARE, {}).get('softarm', 'unknown')}"
                ) from error
            if tick is not None:
                yield tick

    def ticks(self) -> Iterator[tuple[Inputs, Outputs]]:
        """Return inputs and outputs of every tick, as `softarm.daemon.runtime.replay.replay` requires."""
        return ((inputs, outputs) for inputs, outputs, _ in self)

    def entries(self) -> Iterator[Entry]:
        """Yield the events, derived from the ticks if the log has none."""
        has_events = False
        for topic, data in mcap_file.messages(self.path):
            if topic == log.EVENT:
                has_events = True
                yield EVENT.decode(data)
        if not has_events:
            offset = int(self.metadata.get(log.CLOCK, {}).get("wall_minus_monotonic_ns", 0))
            changes = Changes(lambda t_ns: utc(t_ns + offset))
            for inputs, outputs in self.ticks():
                yield from (replace(entry, number=0) for entry in changes.take(inputs, outputs))


def read(path: Path | str) -> TickLog:
    """Open a log; an interrupted one is read up to the last complete record.

    Raises LogError when there is no such file or it is not MCAP.
    """
    return TickLog.open(path)


def parts(paths: Sequence[Path]) -> list[TickLog]:
    """Open the logs of one run of the daemon in their order.

    Raises LogError as `read` does, and when they are not parts of one run, or not in their order.
    """
    opened = [read(path) for path in paths]
    for earlier, later in pairwise(opened):
        before, after = (each.metadata.get(log.RUN, {}) for each in (earlier, later))
        if not before or before.get("id") != after.get("id") or int(before["part"]) >= int(after["part"]):
            raise LogError(
                f"{later.path}: does not follow {earlier.path} in one run of the daemon; name the logs of one run, in "
                "their order, or one alone"
            )
    return opened
