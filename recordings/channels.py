"""A channel of a log: a topic and the one type of record on it. Those of the three devices are here."""

import json
from typing import Generic, TypeVar

from pydantic import ConfigDict, RootModel, TypeAdapter
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from softarm.schemas import log
from softarm.schemas.messages import MocapFrame, PressureReading, RailReading

T = TypeVar("T")


class _Message(RootModel[T], Generic[T]):
    """JSON has no NaN: it is written as a string, and read back as the number it was."""

    model_config = ConfigDict(ser_json_inf_nan="strings", allow_inf_nan=True)


class _WithoutDefaults(GenerateJsonSchema):
    """A default may be NaN, which is no JSON; and every message has all its fields."""

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        return self.generate_inner(schema["schema"])


class LogChannel(Generic[T]):
    """A topic and the one type of record on it, as JSON with every digit: it is read as it was written."""

    def __init__(self, topic: str, record: type[T]) -> None:
        self.topic = topic
        self.schema_name = f"softarm.{record.__name__}"
        self._record = record
        self._message = _Message[record]  # type: ignore[valid-type]

    def json_schema(self) -> bytes:
        """Its JSON schema, for viewers."""
        schema = TypeAdapter(self._record).json_schema(mode="serialization", schema_generator=_WithoutDefaults)
        return json.dumps(schema, allow_nan=False).encode()

    def encode(self, record: T) -> bytes:
        """The record as JSON."""
        return self._message.model_construct(root=record).model_dump_json().encode()

    def decode(self, data: bytes) -> T:
        """The record again. Raises pydantic.ValidationError when the log is of another format."""
        return self._message.model_validate_json(data).root


MOCAP = LogChannel(log.MOCAP, MocapFrame)
PRESSURE = LogChannel(log.PRESSURE, PressureReading)
RAIL = LogChannel(log.RAIL, RailReading)
