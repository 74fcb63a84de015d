"""Compares the rail's limits with the robot in the newest logs."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from softarm.common.finding import Finding, ok, problem, warning
from softarm.daemon.limits.findings import EXCITATION, MeasuredLimit, findings
from softarm.recordings import rail_motion
from softarm.recordings.mcap_file import LogError
from softarm.schemas.config import Config
from softarm.schemas.log import LogEntry

BYTES_MAX = 60_000_000  # of the newest logs: some seconds of reading
FLY = f"fly `softarm excite {EXCITATION} --config FILE` twice (docs/operate/limits.md)"


@dataclass(frozen=True, slots=True)
class Shown:
    """Findings from the logs of a folder."""

    folder: Path
    rows: tuple[MeasuredLimit, ...] = ()  # empty if no log shows the rail


def look(folder: Path, logs: Sequence[LogEntry], config: Config) -> Shown:
    """Measure the rail from the newest finished, readable logs, up to about BYTES_MAX."""
    motions, total = [], 0
    for entry in logs:
        if not entry.finished or total > BYTES_MAX:
            continue
        total += entry.bytes
        try:
            motions.append(rail_motion.read(folder / entry.name))
        except LogError:
            continue
    return Shown(folder, findings(motions, config).rows if motions else ())


def judge(facts: Shown) -> Iterator[Finding]:
    """Yield one finding per limit."""
    if not facts.rows:
        yield warning("limits.rail", f"no finished log in {facts.folder} shows the rail", f"to measure it, {FLY}")
    for row in facts.rows:
        name = f"limits.rail.{row.key}"
        if row.is_too_lax:
            yield problem(name, f"{row.configured:g}, less strict than the robot requires: {row.why}", row.advice)
        elif row.bound is None:
            yield warning(name, f"{row.configured:g}, not measured yet: {row.why}", FLY)
        else:
            yield ok(name, f"{row.configured:g}: {row.why}")
