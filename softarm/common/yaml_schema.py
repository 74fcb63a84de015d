"""Validation of a YAML file by its pydantic schema, with all errors and their lines."""

import json
import re
from collections.abc import Callable, Iterable, Mapping
from copy import deepcopy
from functools import partial
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from softarm.common.keys import children, find, leaves
from softarm.common.quantity import shown
from softarm.common.words import nearest
from softarm.common.yaml_lines import Document, FileError, Mistake, Place, refuse

M = TypeVar("M", bound=BaseModel)
REST_TRIES = 3


def fit(
    document: Document,
    schema: type[M],
    more: Mapping[Place, Callable[[], str]] | None = None,
    rules: Callable[[M], Iterable[str]] = lambda fitted: (),
) -> M:
    """Return the schema's object for a document; a group whose keys are all commented out has its defaults.

    Args:
        document: File with the lines of its keys.
        schema: Pydantic model of the file.
        more: Additional errors by place; they replace the errors of the schema there.
        rules: Returns sentences about errors of a valid object, each with the full paths of its keys. If a value is
            invalid, the rules check the object without it, and sentences that name the value are dropped.

    Raises:
        FileError: The document has errors; it contains all errors and the object without the invalid values.
    """
    if not isinstance(document.data, dict):
        names = ", ".join(key.name for key in children(schema))
        raise FileError([f"{document.path}:{document.line(())}: must hold keys; allowed: {names}"])
    found = [Mistake(place, document.line(place), say) for place, say in (more or {}).items()]
    try:
        # In strict JSON a number must be a number (not "0.1", not yes), and a path is a text.
        rest: M | None = _validated(data := _filled(document.data, schema, ()), schema)
    except ValidationError as error:
        items = error.errors(include_url=False)
        found += [each for item in items if (each := _mistake(document, schema, item)).place not in (more or {})]
        rest = _rest(document, data, schema)
    if rest is not None:
        wrong = {".".join(map(str, each.place)) for each in (*document.mistakes, *found)}
        found += [_said(document, text, ()) for text in rules(rest) if not any(name in text for name in wrong)]
    if document.mistakes or found:
        raise refuse(document, [*document.mistakes, *found], rest)
    assert rest is not None
    return rest


def _validated(data: Any, schema: type[M]) -> M:
    """Return the schema's object; raise ValidationError."""
    return schema.model_validate_json(json.dumps(data), strict=True)


def _rest(document: Document, data: Any, schema: type[M]) -> M | None:
    """Return the schema's object without the invalid values, or None if it is still invalid."""
    # A group may become invalid only after one of its values has its default.
    for _ in range(REST_TRIES):
        try:
            return _validated(data, schema)
        except ValidationError as error:
            data = deepcopy(data)
            for item in error.errors(include_url=False):
                _remove(data, document.known(item["loc"]))
    return None


def _remove(data: Any, place: Place) -> None:
    """Remove the value at a place from data; a place in a list removes the whole list."""
    if not place or not isinstance(data, dict) or place[0] not in data:
        return
    name, *inner = place
    if inner and isinstance(data[name], dict):
        _remove(data[name], tuple(inner))
    else:
        del data[name]


def _filled(data: Any, schema: type[BaseModel], place: Place) -> Any:
    """Replace a group without keys by {}."""
    if not isinstance(data, dict):
        return data
    keys = {name: find(schema, (*place, name)) for name, value in data.items() if isinstance(value, dict | None)}
    empty = {name for name, key in keys.items() if key and key.group and not key.nullable and data[name] is None}
    return {name: {} if name in empty else _filled(value, schema, (*place, name)) for name, value in data.items()}


def _mistake(document: Document, schema: type[BaseModel], item: Mapping[str, Any]) -> Mistake:
    """Return a mistake for an error of pydantic, at its line."""
    loc: Place = item["loc"]
    # Pydantic's location also contains the branches of a union.
    place = document.known(loc)
    if item["type"] == "value_error":
        return _said(document, str(item["ctx"]["error"]), place)
    return Mistake(place, document.line(place), partial(_explain, schema, place, item))


def _said(document: Document, text: str, otherwise: Place) -> Mistake:
    """Return a mistake at the first key that a sentence names, or at another place."""
    paths = (tuple(word.split(".")) for word in re.findall(r"(?<![a-z_0-9.])[a-z_0-9.]+\.[a-z_0-9]+", text))
    place = next((path for path in paths if path in document.lines), otherwise)
    return Mistake(place, document.line(place), partial(str.removeprefix, text, f"{'.'.join(map(str, place))} "))


def _explain(schema: type[BaseModel], place: Place, item: Mapping[str, Any]) -> str:
    key, value, kind = find(schema, place), item["input"], item["type"]
    if kind == "extra_forbidden":
        return _unknown_key(schema, place)
    if kind == "missing":
        wanted = find(schema, item["loc"])
        return f"{item['loc'][-1]} is missing; allowed {wanted.allowed if wanted else 'any'}; add it"
    if key is None:
        return f"{item['msg']}; write another value"
    if kind.endswith("too_short"):
        return f"is empty; allowed {key.allowed}; write one"
    text = f"is {shown(value)}; allowed {key.allowed}"
    if key.quantity and (hint := key.quantity.hint(value)):
        return f"{text}; {hint}"
    if key.group is not None or key.field.is_required() or key.default in (shown({}), shown([])):
        return f"{text}; change it"
    return f"{text}; change it, or remove the line for the default {key.default}"


def _unknown_key(schema: type[BaseModel], place: Place) -> str:
    parent = find(schema, place[:-1])
    group = parent.group if parent is not None else schema
    known = {str(key.path[-1]): key for key in (children(group, place[:-1]) if group is not None else [])}
    same = [key for key in leaves(schema) if key.path[-1] == place[-1]]
    if len(same) == 1:
        return f"unknown key here; move it to {same[0].name} (allowed {same[0].allowed}; default {same[0].default})"
    if near := nearest(str(place[-1]), known, cutoff=0.5):
        key = known[near]
        default = "" if key.group else f"; default {key.default}"
        return f"unknown key; did you mean {near}? (allowed {key.allowed}{default})"
    return f"unknown key; remove it, or use one of {', '.join(known)}"
