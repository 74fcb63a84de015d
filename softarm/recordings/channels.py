"""Channels of a log, each a topic with one type of record, and the channels of the devices and events."""

import json
from typing import Generic, TypeVar

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
