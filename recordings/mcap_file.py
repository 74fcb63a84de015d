"""Whole records of an MCAP file, also of one that breaks off in the middle."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from mcap.records import Channel, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC


class LogError(Exception):
    """A file that is not a log, or cannot be read; names the file and the next step."""


def records(path: Path) -> Iterator[McapRecord]:
    """Every whole record, in file order; a file that breaks off just ends.

    What stands on nothing (a message of a channel, a channel of a schema, that did not come before) is left out.

    Raises LogError when there is no such file or it is not MCAP.
    """
    try:
        file = path.open("rb")
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror}); see `softarm status` for the logs") from error
    with file:
        magic = file.read(len(MCAP0_MAGIC))
        if not MCAP0_MAGIC.startswith(magic):
            raise LogError(f"{path}: not a log; a log is an MCAP file, as the recorder writes it")
        file.seek(0)
        yield from stream(file, os.fstat(file.fileno()).st_size)


def stream(file: IO[bytes], record_max: int) -> Iterator[McapRecord]:
    """Every whole record of what is being read, a pipe too, as `records` does; none may be larger than record_max."""
    found = StreamReader(file, record_size_limit=record_max).records
    schemas, channels = {0}, set[int]()  # 0: a channel without one
    while True:
        try:
            record = next(found)
        except Exception:  # the library raises whatever its parser met at the break
            return
        match record:
            case Schema():
                schemas.add(record.id)
            case Channel() if record.schema_id in schemas:
                channels.add(record.id)
            case Channel():
                continue
            case Message() if record.channel_id not in channels:
                continue
        yield record


def messages(path: Path) -> Iterator[tuple[str, bytes]]:
    """Topic and data of every whole message, in file order. Raises LogError as `records` does."""
    topics: dict[int, str] = {}
    for record in records(path):
        if isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, Message):
            yield topics[record.channel_id], record.data


def is_finished(path: Path) -> bool:
    """Does the file end as a whole MCAP file does? Raises OSError when it cannot be read."""
    with path.open("rb") as file:
        if os.fstat(file.fileno()).st_size < 2 * len(MCAP0_MAGIC):
            return False
        file.seek(-len(MCAP0_MAGIC), os.SEEK_END)
        return bool(file.read() == MCAP0_MAGIC)
