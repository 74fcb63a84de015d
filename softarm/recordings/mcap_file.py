"""Complete records of an MCAP file, even if it breaks off."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from mcap.records import Channel, Footer, Header, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC


class LogError(Exception):
    """Error about a file that is not a log or cannot be read, with its name and the next step."""


def records(path: Path) -> Iterator[tuple[str, McapRecord]]:
    """Yield every complete record in file order, up to the point where the file breaks off.

    A message has its topic, any other record an empty text. A message without its channel, or a channel without its
    schema, is left out.

    Raises:
        LogError: The file does not exist, is not MCAP, or ends as a complete file but breaks off before that.
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
        count = 0
        for topic, record in stream(file, os.fstat(file.fileno()).st_size):
            yield topic, record
            count += isinstance(record, Message)
            if isinstance(record, Footer):
                return
        if _has_end(file):
            raise LogError(
                f"{path}: is damaged after {count} messages; restore a copy, or save these with MCAP's own program: "
                "mcap recover"
            )


def stream(file: IO[bytes], record_max: int) -> Iterator[tuple[str, McapRecord]]:
    """Yield every complete record of a stream, such as a pipe, as `records` does, up to `record_max` bytes each."""
    found = StreamReader(file, record_size_limit=record_max).records
    schemas, topics = {0}, dict[int, str]()  # 0: channels without a schema
    while True:
        try:
            record = next(found)
        except Exception:  # the library's parser raises various errors at the break
            return
        match record:
            case Schema():
                schemas.add(record.id)
            case Channel() if record.schema_id in schemas:
                topics[record.id] = record.topic
            case Channel():
                continue
            case Message():
                if record.channel_id in topics:
                    yield topics[record.channel_id], record
                continue
        yield "", record


def messages(path: Path) -> Iterator[tuple[str, bytes]]:
    """Yield topic and data of every complete message in file order.

    Raises:
        LogError: The file does not exist or is not MCAP.
    """
    for topic, _, data in stamped_messages(path):
        yield topic, data


def stamped_messages(path: Path) -> Iterator[tuple[str, int, bytes]]:
    """Yield topic, time of logging in ns since 1970 and data of every complete message, as `messages` does."""
    for topic, record in records(path):
        if isinstance(record, Message):
            yield topic, record.log_time, record.data


def origin(path: Path) -> tuple[str, str]:
    """Return the library that wrote a file, and the encoding of its first channel; empty if there is none.

    Raises:
        LogError: The file does not exist or is not MCAP.
    """
    library = ""
    for _, record in records(path):
        if isinstance(record, Header):
            library = record.library
        elif isinstance(record, Channel):
            return library, record.message_encoding
    return library, ""


def is_finished(path: Path) -> bool:
    """Return whether the file ends as a complete MCAP file. Raises OSError if the file cannot be read."""
    with path.open("rb") as file:
        return _has_end(file)


def _has_end(file: IO[bytes]) -> bool:
    if os.fstat(file.fileno()).st_size < 2 * len(MCAP0_MAGIC):
        return False
    file.seek(-len(MCAP0_MAGIC), os.SEEK_END)
    return bool(file.read() == MCAP0_MAGIC)
