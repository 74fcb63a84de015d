"""Compares the rail's limits with the robot in the newest logs."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from softarm.common.finding import Finding, ok, problem, warning
from softarm.daemon.limits.findings import EXCITATION, MeasuredLimit, findings
from softarm.recordings import rail_motion
from softarm.recordings.mcap_file import LogError
from softarm.schemas.config import Config
from softarm.schemas.log import LogEntry

BYTES_MAX = 60_000_000  # of the newest logs: some seconds of reading
FLY = f"fly `softarm excite {EXCITATION} --config FILE` twice (docs/operate/limits.md)"


def look(folder: Path, logs: Sequence[LogEntry], config: Config) -> tuple[MeasuredLimit, ...]:
    """Measure the rail from the newest finished, readable logs, up to about BYTES_MAX; empty if none shows it."""
    motions, total = [], 0
    for entry in logs:
        if not entry.finished or total > BYTES_MAX:
            continue
        total += entry.bytes
        try:
            motions.append(rail_motion.read(folder / entry.name))
        except LogError:
            continue
    return findings(motions, config).rows if motions else ()


def judge(rows: Sequence[MeasuredLimit], folder: Path) -> Iterator[Finding]:
    """Yield one finding per limit."""
    if not rows:
        yield warning("limits.rail", f"no finished log in {folder} shows the rail", f"to measure it, {FLY}")
    for row in rows:
        name = f"limits.rail.{row.key}"
        if row.is_too_lax:
            yield problem(name, f"{row.configured:g}, less strict than the robot requires: {row.why}", row.advice)
        elif row.bound is None:
            yield warning(name, f"{row.configured:g}, not measured yet: {row.why}", FLY)
        else:
            yield ok(name, f"{row.configured:g}: {row.why}")
