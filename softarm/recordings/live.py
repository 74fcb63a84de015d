"""Log during its recording: its channels, and the file, of which a killed process leaves complete records behind."""

import json
import os
import time
from collections.abc import Iterable, Mapping
from typing import Any, BinaryIO, Generic, NamedTuple, TypeVar

from mcap.writer import Writer
from pydantic import ConfigDict, RootModel, TypeAdapter
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from softarm.schemas import log
from softarm.schemas.events import Entry
from softarm.schemas.messages import MocapFrame, PressureReading, RailReading

T = TypeVar("T")


class _Message(RootModel[T], Generic[T]):
    """Base of the records as JSON, with NaN and infinity as strings, since JSON has neither."""

    model_config = ConfigDict(ser_json_inf_nan="strings", allow_inf_nan=True)


class _WithoutDefaults(GenerateJsonSchema):
    """Schema generator that omits defaults, which may be NaN; every message has all its fields."""

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        return self.generate_inner(schema["schema"])


class LogChannel(Generic[T]):
    """Topic with one type of record, stored as JSON with every digit so that reading is exact."""

    def __init__(self, topic: str, record: type[T]) -> None:
        self.topic = topic
        self.schema_name = f"softarm.{record.__name__}"
        self._record = record
        self._message = _Message[record]  # type: ignore[valid-type]

    def json_schema(self) -> bytes:
        """Return the JSON schema of the record, for viewers."""
        schema = TypeAdapter(self._record).json_schema(mode="serialization", schema_generator=_WithoutDefaults)
        return json.dumps(schema, allow_nan=False).encode()

    def encode(self, record: T) -> bytes:
        """Return the record as JSON."""
        return self._message.model_construct(root=record).model_dump_json().encode()

    def decode(self, data: bytes) -> T:
        """Return the record of a message. Raises pydantic.ValidationError if the log has another format."""
        return self._message.model_validate_json(data).root


MOCAP = LogChannel(log.MOCAP, MocapFrame)
PRESSURE = LogChannel(log.PRESSURE, PressureReading)
RAIL = LogChannel(log.RAIL, RailReading)
EVENT = LogChannel(log.EVENT, Entry)


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
