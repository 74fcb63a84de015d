"""Reads logs as ticks, also those of a killed daemon."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

from softarm.daemon.control.records import Inputs, Outputs, TickTiming
from softarm.daemon.logbook import ticks
from softarm.daemon.logbook.history import Changes, utc
from softarm.recordings import mcap_file
from softarm.recordings.live import EVENT
from softarm.recordings.log_file import LogFile
from softarm.recordings.mcap_file import LogError
from softarm.schemas import log
from softarm.schemas.config import Limits
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


def exceeded(ticks: Iterable[tuple[Inputs, Outputs]], limits: Limits) -> list[str]:
    """Return a sentence per exceeded limit, for the read-back of the axis and the sent commands."""
    carts_m, velocities_m_s, pressures_kpa = [], [], []
    for inputs, outputs in ticks:
        if inputs.rail is not None:
            carts_m.append(inputs.rail.position_m)
        velocities_m_s.append(abs(outputs.sent.cart_velocity_m_s))
        pressures_kpa.append(outputs.sent.pressure_kpa)
    rail, pressure = limits.rail, limits.pressure
    problems = []
    if carts_m and not rail.position_min_m <= min(carts_m) <= max(carts_m) <= rail.position_max_m:
        problems.append(f"the cart left its limits: {min(carts_m):.3f} to {max(carts_m):.3f} m")
    if any(velocity > rail.velocity_max_m_s for velocity in velocities_m_s):
        problems.append("a velocity above its limit was sent")
    if not all(pressure.min_kpa <= kpa <= pressure.max_kpa for kpa in pressures_kpa):
        problems.append("a pressure outside its limits was sent")
    return problems
