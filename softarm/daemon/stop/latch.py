"""Latch of the emergency stop on disk: after a kill the daemon starts stopped again.

The file has a fixed size, exists before anything can stop and is overwritten in place, so a full disk cannot prevent
the write. An interrupted write leaves an unreadable file, and an unreadable file counts as a stop.
"""

import contextlib
import fcntl
import json
import logging
import os
import secrets
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from softarm.common import files, realtime
from softarm.daemon.logbook import folder

log = logging.getLogger(__name__)

VERSION = 1
SIZE = 4096  # bytes, one page: written as a whole
REASON_MAX = 300  # characters: fit into SIZE as JSON, whatever they are
TIME_MAX_S = 253_402_300_800.0  # the year 10000, beyond the range of datetime
RETRY_S = 1.0  # pause before a failed write is repeated
OVERDUE_S = 1.0  # a slower write is reported as a problem
PRIORITY = 2  # of SCHED_FIFO, like the dedicated stop port


class Stop(NamedTuple):
    """Reason and time of an emergency stop; empty while nothing is stopped."""

    reason: str | None = None
    time_s: float | None = None  # Unix time; None if unknown


class LatchError(Exception):
    """The latch cannot be kept; the message names the file and the next step."""


def encoded(stop: Stop) -> bytes:
    """Return the content of the file, padded to its size."""
    record: dict[str, object] = {"version": VERSION, "stopped": None}
    if stop.reason is not None:
        record |= {"stopped": stop.reason[:REASON_MAX], "time": stop.time_s}
    return json.dumps(record).encode().ljust(SIZE - 1) + b"\n"


def decoded(content: bytes) -> Stop:
    """Return the stop in a file's content, or raise ValueError if it is not a record of this version."""
    record = json.loads(content) if len(content) == SIZE else None
    if not isinstance(record, dict) or "version" not in record:
        raise ValueError(f"{len(content)} bytes, not a record of a stop")
    if record["version"] != VERSION:
        raise ValueError(f"version {record['version']!r}, this software reads {VERSION}")
    reason, time_s = record.get("stopped"), record.get("time")
    # A clear record has no time: an interrupted write of one over a stop must not decode as clear.
    expected = {"version", "stopped"} if reason is None else {"version", "stopped", "time"}
    if set(record) != expected or not isinstance(reason, str | None):
        raise ValueError("not a record of a stop")
    return Stop(reason, time_s if isinstance(time_s, float) and 0 < time_s < TIME_MAX_S else None)


class LatchKeeper:
    """Writer of the latch, in a thread of its own."""

    def __init__(
        self,
        path: Path,
        realtime_priority: int = 0,
        clock: Callable[[], float] = time.monotonic,
        wall: Callable[[], float] = time.time,
    ) -> None:
        """Create a keeper that has not opened its file yet; `clock` is monotonic and `wall` Unix time, s."""
        self.path, self._clock, self._wall = path.absolute(), clock, wall
        self._priority = min(PRIORITY, realtime_priority)
        self._noted = Stop()
        self._kept = Stop()  # content of the file
        self._since_s = 0.0  # time of the latest note
        self._failed: str | None = None
        self._wakeup, self._stopping = threading.Event(), threading.Event()
        self._thread: threading.Thread | None = None
        self.left: str | None = None  # emergency stop left by the previous daemon
        self.left_at: datetime | None = None  # its time

    def start(self) -> None:
        """Read the latch of the previous daemon and start the thread.

        Raises:
            LatchError: The file cannot be created, read or written, or another daemon uses it.
        """
        try:
            self._file, content = _opened(self.path)
        except OSError as error:
            raise LatchError(_no_place(self.path, error)) from error
        try:
            found = decoded(content)
        except (ValueError, RecursionError) as error:
            found = Stop(f"the previous emergency stop is unknown: the latch is unreadable ({self.path}: {error})")
        self.left = found.reason
        self.left_at = None if found.time_s is None else datetime.fromtimestamp(found.time_s, UTC)
        self._noted = self._kept = found
        self._thread = threading.Thread(target=self._run, name="latch", daemon=True)
        self._thread.start()

    def note(self, reason: str | None) -> None:
        """Set the reason for the current stop, or None. Called in every tick, and by the stop port; never blocks."""
        if reason == self._noted.reason:
            return
        self._noted, self._since_s = Stop(reason, None if reason is None else self._wall()), self._clock()
        self._wakeup.set()

    @property
    def problem(self) -> str | None:
        """Return why the latest note is not on disk although it should be, or None."""
        noted, kept = self._noted, self._kept
        if self._failed is not None or noted == kept:
            return self._failed
        late_s = self._clock() - self._since_s
        return f"{self.path}: not written for {late_s:.0f} s" if late_s > OVERDUE_S else None

    def stop(self) -> None:
        """Write the latest note, or remove the file if nothing is stopped. Takes at most a second."""
        if self._thread is None:
            return
        self._stopping.set()
        self._wakeup.set()
        self._thread.join(timeout=OVERDUE_S)
        if not self._thread.is_alive():
            if self._kept.reason is None and self._noted.reason is None:
                with contextlib.suppress(OSError):
                    self.path.unlink()
            os.close(self._file)
        self._thread = None

    def _run(self) -> None:
        realtime.outrank_own_threads(self._priority)
        last = False
        while not last:
            self._wakeup.wait(None if self._failed is None else RETRY_S)
            self._wakeup.clear()
            last = self._stopping.is_set()  # read first: an earlier note is still written
            self._keep(self._noted)

    def _keep(self, stop: Stop) -> None:
        if stop == self._kept and self._failed is None:
            return
        try:
            os.pwrite(self._file, encoded(stop), 0)
            os.ftruncate(self._file, SIZE)  # the file may have been larger
            os.fdatasync(self._file)
        except OSError as error:
            self._failed = f"{self.path}: cannot be written ({error.strerror})"
            log.error("the latch of the emergency stop is not written: %s", self._failed)
        else:
            self._kept, self._failed = stop, None


def try_out(path: Path) -> None:
    """Check that a latch can be kept at a path, and leave nothing behind; raise LatchError as `start` does."""
    path = path.absolute()
    try:
        if path.exists():
            os.close(_opened(path)[0])
        else:
            folder.try_out(path.parent)
    except OSError as error:
        raise LatchError(_no_place(path, error)) from error


def _no_place(path: Path, error: OSError) -> str:
    return (
        f"{path}: the latch of the emergency stop cannot be kept there ({error.strerror}); "
        f"make file and folder writable for uid {os.geteuid()}, or name another recorder.directory"
    )


def _create(path: Path) -> None:
    """Create the file without a stop, unless another daemon has just created it: that one may hold its lock."""
    draft = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        files.write_bytes(draft, encoded(Stop()))
        with contextlib.suppress(FileExistsError):
            os.link(draft, path)
    finally:
        draft.unlink(missing_ok=True)


def _opened(path: Path) -> tuple[int, bytes]:
    """Open and lock the file, creating one without a stop if necessary; return descriptor and content."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        _create(path)
    descriptor = os.open(path, os.O_RDWR)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.fstat(descriptor).st_nlink == 0:
            raise LatchError(f"{path}: another daemon of this robot has just ended; start again")
        return descriptor, os.pread(descriptor, SIZE + 1, 0)
    except BlockingIOError:
        os.close(descriptor)
        raise LatchError(f"{path}: another daemon controls this robot; stop it (`softarm status` shows it)") from None
    except (OSError, LatchError):
        os.close(descriptor)
        raise
