"""Finishing of logs, with compression and an index, and recovery of logs left by a killed daemon."""

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
            writer.add_message(
                copies[record.channel_id],
                log_time=record.log_time,
                data=record.data,
                publish_time=record.publish_time,
                sequence=record.sequence,
            )
        pause()
    writer.finish()
