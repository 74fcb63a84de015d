"""Keys of a YAML schema: allowed values, unit and default of each."""

import types
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import annotated_types
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from softarm.common.quantity import PURE, Quantity, shown

KeyPath = tuple[str | int, ...]

# Longest first: the unit is the end of a key's name.
_UNITS = {
    "_m_s2": "m/s^2",
    "_kpa_s": "kPa/s",
    "_m_s": "m/s",
    "_per_m": "1/m",
    "_days": "days",
    "_kpa": "kPa",
    "_hz": "Hz",
    "_rad": "rad",
    "_kg": "kg",
    "_mb": "MB",
    "_m": "m",
    "_s": "s",
}
_KINDS = {
    float: "a number",
    int: "a whole number",
    str: "a text",
    bool: "true or false",
    Path: "a path",
    tuple: "a list",
    dict: "a group of names of your choice",
    Any: "anything",
}


@dataclass(frozen=True, slots=True)
class Key:
    """One key of the file; a group has keys of its own, a leaf has a value."""

    path: KeyPath
    field: FieldInfo

    @property
    def name(self) -> str:
        """Return the dotted path of the key."""
        return ".".join(map(str, self.path))

    @property
    def group(self) -> type[BaseModel] | None:
        """Return the schema of a group's keys, or None for a leaf or a group with free names."""
        return next(
            (kind for kind in _kinds(self.field) if isinstance(kind, type) and issubclass(kind, BaseModel)), None
        )

    @property
    def nullable(self) -> bool:
        """Return whether null is allowed."""
        return type(None) in _kinds(self.field)

    @property
    def unit(self) -> str:
        """Return the unit at the end of the name, or an empty text."""
        return next((unit for end, unit in _UNITS.items() if str(self.path[-1]).endswith(end)), "")

    @property
    def default(self) -> str:
        """Return the default as it is written in the file."""
        if self.field.is_required():
            return "none"
        return shown(self.field.get_default(call_default_factory=True))

    @property
    def quantity(self) -> Quantity | None:
        """Return the key's quantity with unit and bounds, or None if it is not a number."""
        kinds = _kinds(self.field)
        if not {int, float} & set(kinds):
            return None
        limits: dict[str, Any] = {"name": self.name, "unit": self.unit or PURE, "whole": float not in kinds}
        for rule in _rules(self.field):
            match rule:
                case annotated_types.Ge(ge=value):
                    limits |= {"low": value}
                case annotated_types.Gt(gt=value):
                    limits |= {"low": value, "above": True}
                case annotated_types.Le(le=value):
                    limits |= {"high": value}
                case annotated_types.Lt(lt=value):
                    limits |= {"high": value, "below": True}
        return Quantity(**limits)

    @property
    def bounds(self) -> str:
        """Return the allowed numbers with their unit, or an empty text without bounds."""
        return self.quantity.bounds if self.quantity else ""

    @property
    def allowed(self) -> str:
        """Return the allowed values as a sentence."""
        if self.group is not None:
            return f"a group with the keys {', '.join(str(child.path[-1]) for child in children(self.group))}"
        kinds = _kinds(self.field)
        choices = [shown(value) for kind in kinds if get_origin(kind) is Literal for value in get_args(kind)]
        if choices:
            return " or ".join(choices)
        if self.quantity and self.quantity.bounds:
            return str(self.quantity)
        names = dict.fromkeys(_KINDS.get(get_origin(kind) or kind, "") for kind in kinds)
        unit = f" in {self.unit}" if self.unit and self.quantity else ""
        return " or ".join(filter(None, names)) + unit + (" or null" if self.nullable else "")


def children(schema: type[BaseModel], under: KeyPath = ()) -> list[Key]:
    """Return a group's own keys, in the schema's order."""
    return [Key((*under, name), field) for name, field in schema.model_fields.items()]


def leaves(schema: type[BaseModel], under: KeyPath = ()) -> Iterator[Key]:
    """Yield all keys that hold a value, through nested groups."""
    for key in children(schema, under):
        if key.group is None:
            yield key
        else:
            yield from leaves(key.group, key.path)


def find(schema: type[BaseModel], path: KeyPath) -> Key | None:
    """Return the key at a path, or None; the path may contain free names and indices of lists."""
    group: type[BaseModel] | None = schema
    found: Key | None = None
    for depth, name in enumerate(path, 1):
        if group is not None:
            field = group.model_fields.get(str(name))
        else:
            inner = _values_of(found.field) if found is not None else None
            field = FieldInfo.from_annotation(inner) if inner is not None else None
        if field is None:
            return None
        found = Key(path[:depth], field)
        group = found.group
    return found


def _kinds(field: FieldInfo) -> tuple[Any, ...]:
    annotation = field.annotation
    kinds = get_args(annotation) if get_origin(annotation) in (Union, types.UnionType) else (annotation,)
    return tuple(get_args(kind)[0] if get_origin(kind) is Annotated else kind for kind in kinds)


def _rules(field: FieldInfo) -> Iterator[Any]:
    """Yield the bounds of a field and of the members of a union."""
    yield from field.metadata
    for kind in get_args(field.annotation):
        for rule in getattr(kind, "__metadata__", ()):
            yield from rule.metadata if isinstance(rule, FieldInfo) else (rule,)


def _values_of(field: FieldInfo) -> Any | None:
    """Return the type of the values of a dict or list."""
    for kind in _kinds(field):
        if get_origin(kind) in (dict, tuple):
            return get_args(kind)[1 if get_origin(kind) is dict else 0]
    return None
