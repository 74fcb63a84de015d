"""What a schema says of each key of its YAML file: what it takes, in which unit, and its default."""

import types
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin

import annotated_types
from pydantic import BaseModel
from pydantic.fields import FieldInfo

KeyPath = tuple[str, ...]

# Longest first: the unit is the end of a key's name.
_UNITS = {
    "_m_s2": "m/s^2",
    "_kpa_s": "kPa/s",
    "_m_s": "m/s",
    "_per_m": "1/m",
    "_kpa": "kPa",
    "_hz": "Hz",
    "_rad": "rad",
    "_kg": "kg",
    "_m": "m",
    "_s": "s",
}
# What people write by mistake, and what it is worth in the key's own unit.
_MISTAKEN_UNITS = {
    "m": (("mm", 1e-3), ("cm", 1e-2)),
    "m/s": (("mm/s", 1e-3), ("cm/s", 1e-2)),
    "m/s^2": (("mm/s^2", 1e-3), ("cm/s^2", 1e-2)),
    "s": (("ms", 1e-3), ("us", 1e-6)),
    "kPa": (("Pa", 1e-3), ("mbar", 1e-1)),
    "kPa/s": (("Pa/s", 1e-3), ("mbar/s", 1e-1)),
}
_KINDS = {float: "a number", int: "a whole number", str: "a text", bool: "true or false", Path: "a path"}


@dataclass(frozen=True, slots=True)
class Key:
    """One key of the file; a group has keys of its own, a leaf has a value."""

    path: KeyPath
    field: FieldInfo

    @property
    def name(self) -> str:
        """The dotted path."""
        return ".".join(self.path)

    @property
    def group(self) -> type[BaseModel] | None:
        """The schema of a group's own keys; None for a leaf or a group with names of the user's choice."""
        return next((kind for kind in _kinds(self.field) if _is_model(kind)), None)

    @property
    def nullable(self) -> bool:
        """Whether the file may say null."""
        return type(None) in _kinds(self.field)

    @property
    def unit(self) -> str:
        """From the end of the name; empty when there is none."""
        return next((unit for end, unit in _UNITS.items() if self.path[-1].endswith(end)), "")

    @property
    def default(self) -> str:
        """As it would stand in the file."""
        if self.field.is_required():
            return "none"
        return text_of(self.field.get_default(call_default_factory=True))

    @property
    def bounds(self) -> str:
        """The allowed numbers with their unit; empty when there is no bound."""
        low = high = ""
        for rule in self.field.metadata:
            match rule:
                case annotated_types.Ge(ge=value):
                    low = f"{value:g}"
                case annotated_types.Gt(gt=value):
                    low = f"above {value:g}"
                case annotated_types.Le(le=value):
                    high = f"{value:g}"
                case annotated_types.Lt(lt=value):
                    high = f"below {value:g}"
        unit = f" {self.unit}" if self.unit else ""
        if low and high:
            return (f"{low}, at most {high}" if low.startswith("above") else f"{low} to {high}") + unit
        if low:
            return (low if low.startswith("above") else f"{low} or more") + unit
        return f"at most {high}{unit}" if high else ""

    @property
    def allowed(self) -> str:
        """What the key takes, for people."""
        if self.group is not None:
            return f"a group with the keys {', '.join(child.path[-1] for child in children(self.group))}"
        kinds = _kinds(self.field)
        literals = [kind for kind in kinds if get_origin(kind) is Literal]
        choices = [text_of(value) for kind in literals for value in get_args(kind)]
        if choices:
            return " or ".join(choices)
        if self.bounds:
            return self.bounds + (", a whole number" if int in kinds else "")
        names = [_KINDS[kind] for kind in kinds if kind in _KINDS] or ["a group of names of your choice"]
        unit = f" in {self.unit}" if self.unit else ""
        return " or ".join(names) + unit + (" or null" if self.nullable else "")

    def admits(self, value: float) -> bool:
        """Whether a number is within the bounds."""
        for rule in self.field.metadata:
            match rule:
                case annotated_types.Ge(ge=bound) if not value >= bound:  # type: ignore[operator]
                    return False
                case annotated_types.Gt(gt=bound) if not value > bound:  # type: ignore[operator]
                    return False
                case annotated_types.Le(le=bound) if not value <= bound:  # type: ignore[operator]
                    return False
                case annotated_types.Lt(lt=bound) if not value < bound:  # type: ignore[operator]
                    return False
        return True

    def unit_hint(self, value: object) -> str:
        """Guess the unit that a number out of bounds was meant in; empty when no guess fits."""
        if isinstance(value, bool) or not isinstance(value, int | float):
            return ""
        for unit, factor in _MISTAKEN_UNITS.get(self.unit, ()):
            if self.admits(value * factor):
                meant = f"{value * factor:g}"
                return f"the key is in {self.unit}: if you meant {value:g} {unit}, write {meant}"
        return ""


def children(schema: type[BaseModel], under: KeyPath = ()) -> list[Key]:
    """List a group's own keys, in the schema's order."""
    return [Key((*under, field.alias or name), field) for name, field in schema.model_fields.items()]


def leaves(schema: type[BaseModel], under: KeyPath = ()) -> Iterator[Key]:
    """Walk all keys that hold a value, groups within groups."""
    for key in children(schema, under):
        if key.group is None:
            yield key
        else:
            yield from leaves(key.group, key.path)


def find(schema: type[BaseModel], path: KeyPath) -> Key | None:
    """Return the key at a path, or None. A name of the user's choice leads into what it names."""
    group: type[BaseModel] | None = schema
    found: Key | None = None
    for depth, name in enumerate(path):
        if group is not None:
            found = next((key for key in children(group, path[:depth]) if key.path[-1] == name), None)
            if found is None:
                return None
            group = found.group
        elif found is not None:
            inner = _values_of(found.field)
            if inner is None:
                return None
            found = Key(path[: depth + 1], FieldInfo.from_annotation(inner))
            group = found.group
    return found


def text_of(value: object) -> str:
    """Show a value as YAML would."""
    match value:
        case None:
            return "null"
        case bool():
            return str(value).lower()
        case float():
            return f"{value:.6g}"
        case str() | Path():
            return f"{str(value)!r}"
    return str(value)


def _kinds(field: FieldInfo) -> tuple[Any, ...]:
    annotation = field.annotation
    if get_origin(annotation) in (Union, types.UnionType):
        return get_args(annotation)
    return (annotation,)


def _is_model(kind: object) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def _values_of(field: FieldInfo) -> Any | None:
    """What stands behind each name of a dict."""
    return get_args(field.annotation)[1] if get_origin(field.annotation) is dict else None
