"""The emergency stop's latch, kept on the disk: a daemon that was killed begins as stopped as it ended.

The file has one size, is there before anything can stop, and is overwritten in place: that needs no room, so a full
disk cannot refuse it. A write that was cut short leaves what cannot be read, and what cannot be read is a stop.
"""

import contextlib
import fcntl
import json
import logging
import os
import re
import threading
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from softarm.common import files
from softarm.daemon.logbook import folder
from softarm.daemon.shell import realtime
from softarm.schemas.config import Config

log = logging.getLogger(__name__)

VERSION = 1
SIZE = 4096  # bytes, one page: the system takes it in one piece
REASON_MAX = 300  # characters of it that are kept: as JSON they fit, whatever they are
TIME_MAX_S = 253_402_300_800.0  # the year 10000, which no calendar here knows
RETRY_S = 1.0  # a write that failed is tried again
OVERDUE_S = 1.0  # a write that takes longer is a problem
PRIORITY = 2  # of SCHED_FIFO, like the stop's own way


class Stop(NamedTuple):
    """What stopped the robot, and when; of none, nothing."""

    reason: str | None = None
    time_s: float | None = None  # of Unix' time; files up to November 2026 do not say


class LatchError(Exception):
    """The latch cannot be kept; names the file and the next step."""


def latch_path(config: Config, environment: Mapping[str, str] = os.environ) -> Path:
    """Of the robot on this axis: in the service's own folder, otherwise beside the logs.

    A robot has one axis, whichever configuration names it and on whatever port its daemon answers.
    """
    folder = environment.get("STATE_DIRECTORY", "").partition(":")[0]
    rail = config.drivers.rail
    name = re.sub(r"[^A-Za-z0-9.-]", "_", f"stop-{rail.host}-{rail.port}")
    return (Path(folder) if folder else config.recorder.directory) / f"{name}.json"


def encoded(stop: Stop) -> bytes:
    """The file's content, padded to its size."""
    record: dict[str, object] = {"version": VERSION, "stopped": None}
    if stop.reason is not None:
        record["stopped"] = stop.reason[:REASON_MAX]
        record |= {} if stop.time_s is None else {"time": stop.time_s}
    return json.dumps(record).encode().ljust(SIZE - 1) + b"\n"


def decoded(content: bytes) -> Stop:
    """What `encoded` was given. Raises ValueError on everything else, a newer version included."""
    record = json.loads(content) if len(content) == SIZE else None
    if not isinstance(record, dict) or "version" not in record:
        raise ValueError(f"{len(content)} bytes that are no record of a stop")
    if record["version"] != VERSION:
        raise ValueError(f"version {record['version']!r}, this software reads {VERSION}")
    reason = record.get("stopped")
    known = {"version", "stopped"} if reason is None else {"version", "stopped", "time"}
    if not {"version", "stopped"} <= set(record) <= known or not isinstance(reason, str | None):
        raise ValueError("a record of a stop that says something else")
    time_s = record.get("time")
    return Stop(reason, time_s if isinstance(time_s, float) and 0 < time_s < TIME_MAX_S else None)


class LatchKeeper:
    """Keeps the latch from start to stop, in a thread of its own."""

    def __init__(
        self,
        path: Path,
        realtime_priority: int = 0,
        clock: Callable[[], float] = time.monotonic,
        wall: Callable[[], float] = time.time,
    ) -> None:
        """realtime_priority: the control loop's. clock, wall: seconds, the latter of Unix' time."""
        self.path, self._clock, self._wall = path.absolute(), clock, wall
        self._priority = min(PRIORITY, realtime_priority)
        self._wanted = Stop()  # as noted last
        self._kept = Stop()  # as the file has it
        self._since_s = 0.0  # the note that the file lacks
        self._failed: str | None = None
        self._bell, self._stopping = threading.Event(), threading.Event()
        self._thread: threading.Thread | None = None
        self.left: str | None = None  # why the robot was stopped when the daemon before this one ended
        self.left_at: datetime | None = None  # since when

    def start(self) -> None:
        """Read what was left, and begin.

        Raises LatchError when the file cannot be read and written, or made, or another daemon has it.
        """
        try:
            self._file, content = _opened(self.path)
        except OSError as error:
            raise LatchError(_no_place(self.path, error)) from error
        try:
            found = decoded(content)
        except (ValueError, RecursionError) as error:
            found = Stop(f"whether the robot was stopped is not known ({self.path}: {error})")
        self.left = found.reason
        self.left_at = None if found.time_s is None else datetime.fromtimestamp(found.time_s, UTC)
        self._wanted = self._kept = found
        self._thread = threading.Thread(target=self._run, name="latch", daemon=True)
        self._thread.start()

    def note(self, reason: str | None) -> None:
        """Keep this from now on. For the control loop's thread, every tick; never blocks."""
        if reason == self._wanted.reason:
            return
        self._wanted, self._since_s = Stop(reason, None if reason is None else self._wall()), self._clock()
        self._bell.set()

    @property
    def problem(self) -> str | None:
        """Why what was noted is not on the disk, when it should be."""
        wanted, kept = self._wanted, self._kept
        if self._failed is not None or wanted == kept:
            return self._failed
        late_s = self._clock() - self._since_s
        return f"{self.path}: not written for {late_s:.0f} s" if late_s > OVERDUE_S else None

    def stop(self) -> None:
        """Write what was noted last; where nothing is stopped, leave no file behind. Takes a second at most."""
        if self._thread is None:
            return
        self._stopping.set()
        self._bell.set()
        self._thread.join(timeout=OVERDUE_S)
        if not self._thread.is_alive():
            if self._kept.reason is None and self._wanted.reason is None:
                with contextlib.suppress(OSError):
                    self.path.unlink()
            os.close(self._file)
        self._thread = None

    def _run(self) -> None:
        realtime.outrank_guests(self._priority)
        last = False
        while not last:
            self._bell.wait(None if self._failed is None else RETRY_S)
            self._bell.clear()
            last = self._stopping.is_set()  # looked at first: a note that came before is written
            self._keep(self._wanted)

    def _keep(self, stop: Stop) -> None:
        if stop == self._kept and self._failed is None:
            return
        try:
            os.pwrite(self._file, encoded(stop), 0)
            os.ftruncate(self._file, SIZE)  # something else may have lain there
            os.fdatasync(self._file)
        except OSError as error:
            self._failed = f"{self.path}: cannot be written ({error.strerror})"
            log.error("the emergency stop's latch is not kept: %s", self._failed)
        else:
            self._kept, self._failed = stop, None


def try_out(path: Path) -> None:
    """Could a latch be kept there? Leaves nothing behind. Raises LatchError, as `LatchKeeper.start` would."""
    path = path.absolute()
    try:
        if path.exists():
            os.close(_opened(path)[0])  # which frees it again
        else:
            folder.try_out(path.parent)
    except OSError as error:
        raise LatchError(_no_place(path, error)) from error


def _no_place(path: Path, error: OSError) -> str:
    return (
        f"{path}: cannot be kept there ({error.strerror}), and an emergency stop would not outlive this "
        f"daemon; make file and folder writable for uid {os.geteuid()}, or name another recorder.directory"
    )


def _opened(path: Path) -> tuple[int, bytes]:
    """The file's descriptor and content; makes one that says nothing is stopped where there is none.

    Raises OSError; LatchError where another daemon has it.
    """
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        files.write_bytes(path, encoded(Stop()))
    descriptor = os.open(path, os.O_RDWR)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.fstat(descriptor).st_nlink == 0:
            raise LatchError(f"{path}: another daemon of this robot ended this instant; start again")
        return descriptor, os.pread(descriptor, SIZE + 1, 0)
    except BlockingIOError:
        os.close(descriptor)
        raise LatchError(f"{path}: another daemon has this robot; stop that one, `softarm status` asks it") from None
    except (OSError, LatchError):
        os.close(descriptor)
        raise
