"""A YAML file as its pydantic schema has it, or all that is wrong with it, line by line."""

import json
import re
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from softarm.common.keys import children, find, leaves
from softarm.common.quantity import shown
from softarm.common.words import nearest
from softarm.common.yaml_lines import Document, FileError, Finding, Place, refuse

M = TypeVar("M", bound=BaseModel)
REST_TRIES = 3


def fit(
    document: Document,
    schema: type[M],
    more: Mapping[Place, Callable[[], str]] | None = None,
    rules: Callable[[M], Iterable[str]] = lambda fitted: (),
) -> M:
    """Make the schema's object of a document. `more` is wrong at places besides, and goes before what the schema says.

    rules: sentences on what is wrong with an object that fits the schema, each naming its keys by their full paths.
    Where a value does not fit, they are asked of the rest: what names no such value still holds. A group whose keys
    are all commented out has its defaults. Raises FileError with all that is wrong, and the rest.
    """
    if not isinstance(document.data, dict):
        names = ", ".join(key.name for key in children(schema))
        raise FileError([f"{document.path}:{document.line(())}: must hold keys; allowed: {names}"])
    found = [Finding(place, document.line(place), say) for place, say in (more or {}).items()]
    try:
        # By way of JSON, where strict means that a number is a number (not "0.1", not yes), a path a text.
        rest: M | None = _validated(data := _filled(document.data, schema, ()), schema)
    except ValidationError as error:
        items = error.errors(include_url=False)
        found += [each for item in items if (each := _finding(document, schema, item)).place not in (more or {})]
        rest = _rest(document, data, schema)
    if rest is not None:
        wrong = {".".join(map(str, each.place)) for each in (*document.findings, *found)}
        found += [_said(document, text, ()) for text in rules(rest) if not any(name in text for name in wrong)]
    if document.findings or found:
        raise refuse(document, [*document.findings, *found], rest)
    assert rest is not None  # without a finding it fits
    return rest


def _validated(data: Any, schema: type[M]) -> M:
    """Raises ValidationError."""
    return schema.model_validate_json(json.dumps(data), strict=True)


def _rest(document: Document, data: Any, schema: type[M]) -> M | None:
    """What the schema makes of data without the values that do not fit; None where nothing holds then."""
    for _ in range(REST_TRIES):  # a group may be wrong only once a value of it has its default
        try:
            return _validated(data, schema)
        except ValidationError as error:
            for item in error.errors(include_url=False):
                data = _without(data, document.known(item["loc"]))
    return None


def _without(data: Any, place: Place) -> Any:
    """A copy of data without what stands at a place; a place in a list takes the list with it."""
    if not place or not isinstance(data, dict) or place[0] not in data:
        return data
    name, *inner = place
    if inner and isinstance(data[name], dict):
        return data | {name: _without(data[name], tuple(inner))}
    return {key: value for key, value in data.items() if key != name}


def _filled(data: Any, schema: type[BaseModel], place: Place) -> Any:
    """Put {} for a group that is there without keys."""
    if not isinstance(data, dict):
        return data
    keys = {name: find(schema, (*place, name)) for name, value in data.items() if isinstance(value, dict | None)}
    empty = {name for name, key in keys.items() if key and key.group and not key.nullable and data[name] is None}
    return {name: {} if name in empty else _filled(value, schema, (*place, name)) for name, value in data.items()}


def _finding(document: Document, schema: type[BaseModel], item: Mapping[str, Any]) -> Finding:
    """What pydantic found, at the line where it stands, to be put into words."""
    loc: Place = item["loc"]
    place = document.known(loc)  # pydantic's adds the branches of a union
    if item["type"] == "value_error":
        return _said(document, str(item["ctx"]["error"]), place)
    return Finding(place, document.line(place), partial(_explain, schema, place, item))


def _said(document: Document, text: str, otherwise: Place) -> Finding:
    """A sentence, at the first key of the file that it names, or else at another place."""
    place = _named_in(text, document) or otherwise
    return Finding(place, document.line(place), partial(str.removeprefix, text, f"{'.'.join(map(str, place))} "))


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


def _named_in(text: str, document: Document) -> Place | None:
    """The first key of the file that a sentence names by its full path."""
    for word in re.findall(r"[a-z_0-9.]+\.[a-z_0-9]+", text):
        if (place := tuple(word.split("."))) in document.lines:
            return place
    return None
