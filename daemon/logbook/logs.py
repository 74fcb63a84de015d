"""Reading logs, also those of a daemon that was killed, and finishing them: compressed, with an index."""

import fcntl
import glob
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.records import Channel, Message, Metadata, Schema
from mcap.writer import MCAP0_MAGIC, Writer

from softarm.common import files
from softarm.daemon.control.records import Inputs, Outputs, TickTiming
from softarm.daemon.logbook import channels
from softarm.recordings import mcap_file
from softarm.recordings.mcap_file import LogError as LogError
from softarm.schemas import log
from softarm.schemas.config import Config
from softarm.schemas.log import LogEntry
from softarm.schemas.messages import MocapFrame

NEVER: Callable[[], None] = lambda: None  # noqa: E731


@dataclass(frozen=True, slots=True)
class LogFile:
    """A log. Its iterators stream from the file; the summary was taken when it was opened."""

    path: Path
    metadata: Mapping[str, Mapping[str, str]]  # by schemas.log name, as it was at the end
    policies: tuple[Mapping[str, str], ...]  # in the order in which they were used
    records: int  # whole messages
    t_first_ns: int | None  # first tick, CLOCK_MONOTONIC of the recording machine
    t_last_ns: int | None
    finished: bool  # False: the daemon was killed, or is still writing

    @property
    def config(self) -> Config:
        """The configuration that it was recorded under."""
        return Config.model_validate_json(self.metadata[log.CONFIGURATION]["json"])

    @property
    def duration_s(self) -> float:
        """From the first tick to the last."""
        if self.t_first_ns is None or self.t_last_ns is None:
            return 0.0
        return (self.t_last_ns - self.t_first_ns) * 1e-9

    @property
    def ending(self) -> str:
        """How the file ends, in one sentence."""
        whole = f"{self.records} whole records over {self.duration_s:.2f} s"
        if self.finished:
            return f"{self.path}: finished, {whole}"
        return (
            f"{self.path}: not finished (the daemon was killed, the disk was full or it still records), "
            f"{whole}; the recorder finishes it at its next start"
        )

    def __iter__(self) -> Iterator[tuple[Inputs, Outputs, TickTiming]]:
        """Every tick, as the control loop saw it.

        Raises LogError when a tick's own messages are not there (a log of another version, or edited).
        """
        joiner = channels.Joiner()
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
        """What went in and what came out of every tick, as `softarm.daemon.shell.replay.replay` takes it."""
        return ((inputs, outputs) for inputs, outputs, _ in self)

    def inputs(self) -> Iterator[Inputs]:
        """What went into every tick, exactly."""
        return (inputs for inputs, _, _ in self)

    def outputs(self) -> Iterator[Outputs]:
        """What came out of every tick, exactly."""
        return (outputs for _, outputs, _ in self)

    def timings(self) -> Iterator[TickTiming]:
        """How long every tick took."""
        return (timing for _, _, timing in self)

    def frames(self) -> Iterator[MocapFrame]:
        """Every motion capture frame, also those that came after the last whole tick."""
        return (channels.MOCAP.decode(data) for topic, data in mcap_file.messages(self.path) if topic == log.MOCAP)


def read(path: Path | str) -> LogFile:
    """Open a log; one that ends in the middle of a record is read up to the last whole one.

    Raises LogError when there is no such file or it is not MCAP.
    """
    path = Path(path)
    metadata: dict[str, Mapping[str, str]] = {}
    policies: list[Mapping[str, str]] = []
    topics: dict[int, str] = {}
    records, first, last = 0, None, None
    for record in mcap_file.records(path):
        if isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, Metadata):
            metadata[record.name] = record.metadata
            if record.name == log.POLICY:
                policies.append(record.metadata)
        elif isinstance(record, Message):
            records += 1
            if topics[record.channel_id] == log.TICK:
                first = record.log_time if first is None else first
                last = record.log_time
    return LogFile(path, metadata, tuple(policies), records, first, last, is_finished(path))


def is_finished(path: Path) -> bool:
    """Does the file end as a whole MCAP file does? Raises OSError when it cannot be read."""
    with path.open("rb") as file:
        if os.fstat(file.fileno()).st_size < 2 * len(MCAP0_MAGIC):
            return False
        file.seek(-len(MCAP0_MAGIC), os.SEEK_END)
        return bool(file.read() == MCAP0_MAGIC)


def finish(path: Path, pause: Callable[[], None] = NEVER) -> int:
    """Rewrite a log in place, compressed and with an index; returns the number of messages in it.

    Atomic: until the very end the old file stays. A file without a whole message is left alone. `pause` is
    called after every record; what it raises ends the work and leaves the old file. Raises LogError, OSError.
    """
    for stale in path.parent.glob(f".{glob.escape(path.name)}.*"):  # of a kill in the middle of this
        stale.unlink()
    if next(mcap_file.messages(path), None) is None:
        return 0
    with files.replacing(path) as draft:
        return _copy(path, draft, pause)


def recover(path: Path | str, pause: Callable[[], None] = NEVER) -> LogFile:
    """Finish a log that a killed daemon has left; one that is finished or still being written is left alone.

    Raises LogError, OSError.
    """
    path = Path(path)
    with path.open("rb") as file:
        if not is_finished(path) and _lock(file.fileno()):
            finish(path, pause)
    return read(path)


def hold(descriptor: int) -> None:
    """Mark an open log as being written; the mark goes with the process that set it."""
    _lock(descriptor)


def listing(directory: Path) -> tuple[LogEntry, ...]:
    """The logs of a directory, newest first. A directory that is not there holds none."""
    entries = (_entry(path) for path in directory.glob("*.mcap"))
    return tuple(sorted((e for e in entries if e is not None), key=lambda e: (e.modified, e.name), reverse=True))


def _entry(path: Path) -> LogEntry | None:
    try:
        state = path.stat()
        finished = is_finished(path)
        duration = _summarised_duration_s(path) if finished else None
    except FileNotFoundError:  # gone between the listing and the look
        return None
    except Exception:  # unreadable or damaged: listed all the same, so that it can be seen
        finished, duration = False, None
    modified = datetime.fromtimestamp(state.st_mtime, UTC)
    return LogEntry(name=path.name, bytes=state.st_size, modified=modified, duration_s=duration, finished=finished)


def _summarised_duration_s(path: Path) -> float | None:
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    if summary is None or summary.statistics is None:
        return None
    return float(summary.statistics.message_end_time - summary.statistics.message_start_time) * 1e-9


def _lock(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _copy(path: Path, file: Any, pause: Callable[[], None]) -> int:
    """Copy all that is whole into a new, chunked file."""
    writer = Writer(file)
    writer.start(profile="", library="softarm")
    schemas: dict[int, int] = {}
    copies: dict[int, int] = {}
    messages = 0
    for record in mcap_file.records(path):
        if isinstance(record, Schema) and record.id not in schemas:
            schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
        elif isinstance(record, Channel) and record.id not in copies:
            copies[record.id] = writer.register_channel(
                record.topic, record.message_encoding, schemas[record.schema_id], record.metadata
            )
        elif isinstance(record, Metadata):
            writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Message):
            messages += 1
            writer.add_message(
                copies[record.channel_id],
                log_time=record.log_time,
                data=record.data,
                publish_time=record.publish_time,
                sequence=record.sequence,
            )
        pause()
    writer.finish()
    return messages
