"""Log during its recording; a killed process leaves complete records behind."""

import os
import time
from collections.abc import Iterable, Mapping
from typing import Any, BinaryIO, NamedTuple

from mcap.writer import Writer

from softarm.recordings.channels import LogChannel

LIBRARY = "softarm"  # named in the header of the file
SYNC_INTERVAL_S = 1.0  # the most that a power failure may lose


class LogMessage(NamedTuple):
    """Message for a file; both times are nanoseconds: CLOCK_MONOTONIC in a log, the wall clock for Foxglove."""

    topic: str
    log_time: int
    publish_time: int
    data: bytes


def register(writer: Writer, topic: str, schema_name: str, json_schema: bytes) -> int:
    """Register a channel of JSON messages and return its number."""
    schema = writer.register_schema(schema_name, "jsonschema", json_schema)
    return int(writer.register_channel(topic, "json", schema))


class LiveFile:
    """MCAP file without chunks, so that every flush leaves complete records."""

    def __init__(self, file: BinaryIO, channels: Iterable[LogChannel[Any]]) -> None:
        self._file = file
        self._writer = Writer(file, use_chunking=False)
        self._writer.start(profile="", library=LIBRARY)
        self._ids = {
            channel.topic: register(self._writer, channel.topic, channel.schema_name, channel.json_schema())
            for channel in channels
        }
        self._sequence = 0
        self._synced_s = time.monotonic()

    def note(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record, valid from here on."""
        self._writer.add_metadata(name, dict(values))

    def add(self, message: LogMessage) -> None:
        """Write a message on one of the channels."""
        self._sequence += 1
        self._writer.add_message(
            self._ids[message.topic], message.log_time, message.data, message.publish_time, self._sequence
        )

    def flush(self) -> None:
        """Write to the operating system now, and to the disk when the interval is over."""
        self._file.flush()
        if time.monotonic() - self._synced_s >= SYNC_INTERVAL_S:
            os.fsync(self._file.fileno())
            self._synced_s = time.monotonic()
