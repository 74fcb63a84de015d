"""The recorder's directory: creates logs, finishes interrupted ones and deletes the oldest."""

import errno
import logging
import math
import os
import re
import shutil
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryFile
from typing import BinaryIO

from softarm.recordings import log_file, mcap_file
from softarm.schemas.config import Recorder

log = logging.getLogger(__name__)

FREE_MIN_BYTES = 100_000_000  # about ten minutes of flight
PAUSE_RECORDS, PAUSE_S = 20, 0.002
OWN_NAME = re.compile(r"softarm-\d{8}T\d{6}Z(-\d+)?\.mcap")  # only logs named by the recorder are deleted


class Pause:
    """Releases the interpreter every few records of long work for the control loop."""

    def __init__(self) -> None:
        self._records = 0

    def __call__(self) -> None:
        """Count a record."""
        self._records += 1
        if self._records % PAUSE_RECORDS == 0:
            time.sleep(PAUSE_S)


def new_log(directory: Path, wall_ns: int) -> tuple[Path, BinaryIO]:
    """Create an empty log, marked as being written. Raises OSError, also when the disk is nearly full."""
    directory.mkdir(parents=True, exist_ok=True)
    need_room(directory)
    stem = datetime.fromtimestamp(wall_ns * 1e-9, UTC).strftime("softarm-%Y%m%dT%H%M%SZ")
    for suffix in ("", *(f"-{n}" for n in range(2, 1000))):
        path = directory / f"{stem}{suffix}.mcap"
        try:
            file = path.open("xb")
        except FileExistsError:
            continue
        log_file.hold(file.fileno())
        return path.absolute(), file
    raise FileExistsError(errno.EEXIST, f"a thousand logs called {stem}")


def try_out(directory: Path) -> None:
    """Check that a log can be created, leaving nothing behind. Raises OSError."""
    there = next(path for path in (directory.absolute(), *directory.absolute().parents) if path.exists())
    TemporaryFile(dir=there).close()
    need_room(there)


def need_room(directory: Path) -> None:
    """Raise OSError when the disk is nearly full."""
    if shutil.disk_usage(directory).free < FREE_MIN_BYTES:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def free_bytes(directory: Path) -> int | None:
    """Return the free space of the directory's disk, or None if the directory is missing."""
    try:
        return shutil.disk_usage(directory).free
    except OSError:
        return None


def advice(directory: Path, error: OSError) -> str:
    """Return why no log can be written to a directory, and the next step."""
    directory = directory.absolute()
    if error.errno == errno.ENOSPC:
        return (
            f"recorder.directory {directory}: the disk is full (less than "
            f"{FREE_MIN_BYTES // 1_000_000} MB free); delete old logs or use a directory on another disk"
        )
    return (
        f"recorder.directory {directory}: no log can be written there ({error.strerror}); make it "
        f"writable for uid {os.geteuid()}, use another directory, or set recorder.enabled: false"
    )


def finish_left(directory: Path, own: Path, pause: Callable[[], None]) -> None:
    """Finish the interrupted logs until `pause` raises an exception."""
    for path in sorted(directory.glob("*.mcap")):
        try:
            if path != own and path.is_file() and not mcap_file.is_finished(path):  # a pipe would wait for its writer
                log.info("finishing an interrupted log: %s", log_file.recover(path, pause).ending)
        except (OSError, mcap_file.LogError) as error:  # an old log must not disturb the new one
            log.warning("an interrupted log cannot be finished and stays unchanged: %s: %s", path, error)


def delete_oldest(directory: Path, own: Path, settings: Recorder, now_s: float | None = None) -> None:
    """Delete the recorder's oldest logs until the rest is within `keep_mb` and `keep_days`, if these are set.

    A log being written by this or another daemon is never deleted. Raises OSError.
    """
    keep_s = math.inf if settings.keep_days is None else settings.keep_days * 86_400
    keep_bytes = math.inf if settings.keep_mb is None else settings.keep_mb * 1e6
    now_s = time.time() if now_s is None else now_s
    states = {path: path.stat() for path in sorted(directory.glob("*.mcap")) if OWN_NAME.fullmatch(path.name)}
    total_bytes = sum(state.st_size for state in states.values())
    for path, state in states.items():
        too_old = now_s - state.st_mtime > keep_s
        too_much = total_bytes > keep_bytes
        if path == own or not (too_old or too_much) or log_file.is_held(path):
            continue
        path.unlink()
        total_bytes -= state.st_size
        log.info("deleted an old log: %s (recorder.keep_days, recorder.keep_mb)", path)
