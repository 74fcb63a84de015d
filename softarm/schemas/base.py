"""Base class of data models, and JSON conversion of records."""

import re
from typing import Annotated, Any, TypeVar, get_type_hints

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema


class Strict(BaseModel):
    """Immutable model that refuses unknown keys and non-finite numbers."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def tcp_address(endpoint: str) -> tuple[str, int] | None:
    """Return host and port of a Zenoh endpoint tcp/HOST:PORT, or None for another form or a port above 65535."""
    found = re.fullmatch(r"tcp/\[?(.+?)\]?:([0-9]{1,5})", endpoint)
    return None if found is None or int(found[2]) > 65535 else (found[1], int(found[2]))


def _checked(endpoint: str) -> str:
    if tcp_address(endpoint) is None and not re.fullmatch("(?!tcp/)[a-z-]+/.+", endpoint):
        raise ValueError(f"is {endpoint!r}; allowed tcp/HOST:PORT with a port up to 65535, e.g. tcp/127.0.0.1:7447")
    return endpoint


Endpoint = Annotated[str, AfterValidator(_checked)]  # of Zenoh

# Two numbers as an array of one kind of item: generators of clients hardly know tuples (`prefixItems`).
Pair = Annotated[tuple[float, ...], Field(min_length=2, max_length=2)]
Record = TypeVar("Record", bound=tuple[Any, ...])


def json_array(record: type[Record]) -> type[Record]:
    """Make pydantic read and write a NamedTuple of floats as an array of numbers."""

    def schema(cls: type[Record], source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        count = len(get_type_hints(cls))
        numbers = core_schema.tuple_variable_schema(core_schema.float_schema(), min_length=count, max_length=count)
        return core_schema.no_info_after_validator_function(lambda values: cls(*values), numbers)

    setattr(record, "__get_pydantic_core_schema__", classmethod(schema))  # noqa: B010
    return record


def json_object(record: type[Record]) -> type[Record]:
    """Make pydantic write a NamedTuple as an object of named fields instead of an array."""
    defaults = vars(record)["_field_defaults"]

    def schema(cls: type[Record], source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        fields = {
            name: core_schema.typed_dict_field(handler.generate_schema(kind), required=name not in defaults)
            for name, kind in get_type_hints(cls).items()
        }
        as_object = core_schema.typed_dict_schema(fields, extra_behavior="forbid")
        from_object = core_schema.no_info_after_validator_function(lambda values: cls(**values), as_object)
        return core_schema.json_or_python_schema(
            from_object,
            core_schema.union_schema([core_schema.is_instance_schema(cls), from_object]),
            serialization=core_schema.plain_serializer_function_ser_schema(
                lambda value: value._asdict(), return_schema=as_object
            ),
        )

    setattr(record, "__get_pydantic_core_schema__", classmethod(schema))  # noqa: B010
    return record
