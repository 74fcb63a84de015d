"""Logs as files: summary and list, finishing with compression and an index, and recovery after a killed daemon."""

import fcntl
import glob
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import BinaryIO, Self

from mcap.reader import make_reader
from mcap.records import Channel, Message, Metadata, Schema
from mcap.writer import Writer
from pydantic import ValidationError

from softarm.common import files
from softarm.recordings import mcap_file
from softarm.recordings.live import LIBRARY
from softarm.recordings.mcap_file import LogError
from softarm.schemas import log
from softarm.schemas.config import Config
from softarm.schemas.log import LogEntry


@dataclass(frozen=True, slots=True)
class LogFile:
    """Summary of a log, made when it was opened."""

    path: Path
    metadata: Mapping[str, Mapping[str, str]]  # by name in schemas.log, last values
    policies: tuple[Mapping[str, str], ...]  # in order of use
    records: int  # complete messages
    t_first_ns: int | None  # first tick, CLOCK_MONOTONIC of the recording machine
    t_last_ns: int | None
    finished: bool  # False if the daemon was killed or is still writing

    @classmethod
    def open(cls, path: Path | str) -> Self:
        """Open a log; one that ends within a record is read up to its last complete record.

        Raises:
            LogError: The file does not exist, is not MCAP, or has a newer format.
        """
        path = Path(path)
        metadata: dict[str, Mapping[str, str]] = {}
        policies: list[Mapping[str, str]] = []
        records, first, last = 0, None, None
        for topic, record in mcap_file.records(path):
            if isinstance(record, Metadata):
                metadata[record.name] = record.metadata
                if record.name == log.SOFTWARE:
                    _check_format(path, record.metadata)
                if record.name == log.POLICY:
                    policies.append(record.metadata)
            elif isinstance(record, Message):
                records += 1
                if topic == log.TICK:
                    first = record.log_time if first is None else first
                    last = record.log_time
        return cls(path, metadata, tuple(policies), records, first, last, mcap_file.is_finished(path))

    @property
    def config(self) -> Config:
        """Return the configuration used during the recording. Raises LogError if the log does not contain it."""
        try:
            return Config.model_validate_json(self.metadata[log.CONFIGURATION]["json"])
        except (KeyError, ValidationError) as error:
            what = str(error).partition("\n")[0]
            raise LogError(f"{self.path}: holds no configuration that can be read ({what}); name another log") from None

    @property
    def duration_s(self) -> float:
        """Return the time from the first to the last tick."""
        if self.t_first_ns is None or self.t_last_ns is None:
            return 0.0
        return (self.t_last_ns - self.t_first_ns) * 1e-9

    @property
    def ending(self) -> str:
        """Return one sentence on how the file ends."""
        whole = f"{self.records} complete records over {self.duration_s:.2f} s"
        if self.finished:
            return f"{self.path}: finished, {whole}"
        return (
            f"{self.path}: not finished (the daemon was killed, the disk was full or it still records), "
            f"{whole}; the recorder finishes it at its next start, `softarm logs recover` now"
        )


def _check_format(path: Path, software: Mapping[str, str]) -> None:
    format_ = software.get(log.FORMAT_KEY, "1")
    if not format_.isdecimal() or int(format_) > log.FORMAT:
        raise LogError(
            f"{path}: is a log of format {format_}, written by softarm {software.get('softarm', 'unknown')}; this "
            f"software reads format {log.FORMAT}: update it"
        )


def listing(directory: Path) -> tuple[LogEntry, ...]:
    """Return the logs of a directory, newest first; none if the directory does not exist or cannot be read."""
    try:
        entries = [_entry(path) for path in directory.glob("*.mcap")]
    except OSError:
        return ()
    return tuple(sorted((e for e in entries if e is not None), key=lambda e: (e.modified, e.name), reverse=True))


def _entry(path: Path) -> LogEntry | None:
    try:
        state = path.stat()
        finished = mcap_file.is_finished(path)
        duration = _summarised_duration_s(path) if finished else None
    except FileNotFoundError:  # deleted since the listing
        return None
    except Exception:  # unreadable or damaged logs are listed, too
        finished, duration = False, None
    modified = datetime.fromtimestamp(state.st_mtime, UTC)
    return LogEntry(name=path.name, bytes=state.st_size, modified=modified, duration_s=duration, finished=finished)


def _summarised_duration_s(path: Path) -> float | None:
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    if summary is None or summary.statistics is None:
        return None
    return float(summary.statistics.message_end_time - summary.statistics.message_start_time) * 1e-9


def finish(path: Path, pause: Callable[[], None] = lambda: None) -> None:
    """Rewrite a log in place, compressed and with an index.

    The replacement is atomic. A file without a complete message is left alone. `pause` is called after every record; an
    exception from it ends the work and keeps the old file.

    Raises:
        LogError: The file is not a log.
        OSError: The file cannot be written.
    """
    for stale in path.parent.glob(f".{glob.escape(path.name)}.*"):  # left by a kill during an earlier call
        stale.unlink()
    if next(mcap_file.messages(path), None) is None:
        return
    with files.replacing(path) as draft:
        _copy(path, draft, pause)


def recover(path: Path | str, pause: Callable[[], None] = lambda: None) -> LogFile:
    """Finish a log left by a killed daemon; leave it alone if it is finished or still being written.

    Raises:
        LogError: The file is not a log.
        OSError: The file cannot be written.
    """
    path = Path(path)
    with path.open("rb") as file:
        if not mcap_file.is_finished(path) and hold(file.fileno()):
            finish(path, pause)
    return LogFile.open(path)


def hold(descriptor: int) -> bool:
    """Lock an open log as being written until it is closed; return False if it is locked already."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def is_held(path: Path) -> bool:
    """Return whether a daemon is still writing the log. Raises OSError if the file cannot be read."""
    with path.open("rb") as file:
        return not hold(file.fileno())


def _copy(path: Path, file: BinaryIO, pause: Callable[[], None]) -> None:
    """Copy all complete records into a new, chunked file."""
    writer = Writer(file)
    writer.start(profile="", library=LIBRARY)
    schemas = {0: 0}  # channels without a schema
    copies: dict[int, int] = {}
    for _, record in mcap_file.records(path):
        if isinstance(record, Schema) and record.id not in schemas:
            schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
        elif isinstance(record, Channel) and record.id not in copies:
            copies[record.id] = writer.register_channel(
                record.topic, record.message_encoding, schemas[record.schema_id], record.metadata
            )
        elif isinstance(record, Metadata):
            writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Message):
            writer.add_message(
                copies[record.channel_id],
                log_time=record.log_time,
                data=record.data,
                publish_time=record.publish_time,
                sequence=record.sequence,
            )
        pause()
    writer.finish()
