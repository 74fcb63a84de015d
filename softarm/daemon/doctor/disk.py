"""Checks of the disk for logs: free space, speed, and the days until it is full."""

import os
import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from softarm.common import files
from softarm.common.finding import Finding, State, by, graded, ok, problem, warning
from softarm.daemon.logbook.folder import FREE_MIN_BYTES
from softarm.schemas.config import Recorder
from softarm.schemas.log import LogEntry

WRITTEN_BYTES = 8_000_000
FLIGHT_BYTES_S = 170_000.0  # of a flight, if there is no log to measure
SHARE_MAX = 0.1  # of the disk's speed that logs should take
FLUSH_FINE_MS, FLUSH_BEARABLE_MS = 100.0, 1000.0  # data not yet flushed is lost at a power cut
DAYS_FINE, HOURS_A_DAY = 7.0, 8.0  # of flying


@dataclass(frozen=True, slots=True)
class Disk:
    """Facts about the recorder's folder, or its nearest existing parent."""

    folder: Path
    enabled: bool
    writable: bool
    free_bytes: int
    bytes_s: float | None = None  # write speed; None if not measured
    flush_ms: float | None = None  # time of a small flush
    log_bytes_s: float | None = None  # mean rate of the present logs; None without logs
    bounded: bool = False  # recorder.keep_mb or keep_days


def look(settings: Recorder, logs: Sequence[LogEntry] = (), measured: bool = True) -> Disk:
    """Gather the facts; if `measured`, write a file of 8 MB and delete it."""
    folder = settings.directory.absolute()
    there = next(each for each in (folder, *folder.parents) if files.exists(each))
    writable = there.is_dir() and os.access(there, os.W_OK | os.X_OK)
    bounded = settings.keep_mb is not None or settings.keep_days is not None
    sizes = [(each.bytes, each.duration_s) for each in logs if each.duration_s is not None]
    seconds = sum(lasted_s for _, lasted_s in sizes)
    measured_speed = speed(there) if measured and writable and settings.enabled else None
    bytes_s, flush_ms = measured_speed or (None, None)
    return Disk(
        folder,
        settings.enabled,
        writable,
        shutil.disk_usage(there).free,
        bytes_s,
        flush_ms,
        sum(size for size, _ in sizes) / seconds if seconds > 0.0 else None,
        bounded,
    )


def speed(folder: Path) -> tuple[float, float] | None:
    """Return write speed in bytes/s and the time of a small flush in ms, or None if the disk refuses."""
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            begun_s = time.monotonic()
            file.write(os.urandom(WRITTEN_BYTES))
            file.flush()
            os.fsync(file.fileno())
            written_s = time.monotonic()
            file.write(b"\0" * 4096)
            file.flush()
            os.fsync(file.fileno())
            return WRITTEN_BYTES / (written_s - begun_s), (time.monotonic() - written_s) * 1e3
    except OSError:
        return None


def judge(facts: Disk) -> Iterator[Finding]:
    """Yield findings on the folder, its free space and its speed."""
    if not facts.enabled:
        yield ok("logs", "disabled (recorder.enabled is false)")
        return
    if not facts.writable:
        advice = "make it writable for the daemon's user, or set another recorder.directory"
        yield problem("logs", f"{facts.folder} cannot be written", advice)
        return
    yield _free_space(facts)
    if facts.bytes_s is None or facts.flush_ms is None:
        yield ok("disk's speed", "not measured because the arm is in use or the disk is full")
        return
    figure = f"{facts.bytes_s / 1e6:.0f} MB/s, {facts.flush_ms:.1f} ms to flush"
    needed = facts.log_bytes_s or FLIGHT_BYTES_S
    states = by(needed / facts.bytes_s, SHARE_MAX, 1.0), by(facts.flush_ms, FLUSH_FINE_MS, FLUSH_BEARABLE_MS)
    advice = f"logs take {needed / 1e6:.2f} MB/s: set recorder.directory to a faster disk"
    yield graded("disk's speed", max(states, key=list(State).index), figure, advice)


def _free_space(facts: Disk) -> Finding:
    rate = facts.log_bytes_s or FLIGHT_BYTES_S
    days = facts.free_bytes / (rate * 3600.0 * HOURS_A_DAY)
    source = "the rate of its logs" if facts.log_bytes_s else "the rate of a flight"
    lasts = f"{days:.0f} days of {HOURS_A_DAY:g} h at {rate / 1e3:.0f} kB/s, {source}"
    figure = f"{facts.folder}: {facts.free_bytes / 1e9:.1f} GB free, {lasts}"
    advice = "delete old logs, set recorder.directory to another disk, or set recorder.keep_mb"
    if facts.free_bytes < FREE_MIN_BYTES:
        return problem("logs", figure, f"at least {FREE_MIN_BYTES / 1e6:g} MB are required: {advice}")
    if days < DAYS_FINE and not facts.bounded:
        return warning("logs", figure, advice)
    return ok("logs", figure)
