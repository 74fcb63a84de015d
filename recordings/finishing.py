"""Finishing a log: compressed, with an index, and whole until then; also one that a killed daemon has left."""

import fcntl
import glob
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from mcap.records import Channel, Message, Metadata, Schema
from mcap.writer import Writer

from softarm.common import files
from softarm.recordings import mcap_file
from softarm.recordings.live import LIBRARY
from softarm.recordings.log_file import LogFile

NEVER: Callable[[], None] = lambda: None  # noqa: E731


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
        if not mcap_file.is_finished(path) and _lock(file.fileno()):
            finish(path, pause)
    return LogFile.open(path)


def hold(descriptor: int) -> None:
    """Mark an open log as being written; the mark goes with the process that set it."""
    _lock(descriptor)


def is_held(path: Path) -> bool:
    """Is a daemon still writing it? Raises OSError when it cannot be read."""
    with path.open("rb") as file:
        return not _lock(file.fileno())


def _lock(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _copy(path: Path, file: BinaryIO, pause: Callable[[], None]) -> int:
    """Copy all that is whole into a new, chunked file."""
    writer = Writer(file)
    writer.start(profile="", library=LIBRARY)
    schemas = {0: 0}  # a channel without one
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
