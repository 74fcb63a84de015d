"""Model files: a robot's parameters and a simulator's effects as YAML, to and from `schemas.model.Model`."""

import difflib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ValidationError

from schemas.model import Model

# The shipped model: the seed's simulator.
SEED = Path(__file__).parent / "models" / "seed.yaml"

_HEADER = """\
# A robot's parameters, and the effects that its simulator has. A parameter that is left out has the seed's
# value; an effect without a line under `effects` is absent. schemas/model.py has all units and sources.
"""

Place = tuple[str | int, ...]


class ModelFileError(Exception):
    """All that is wrong with a model file, one `FILE:LINE: key: what is wrong, what is allowed` a line."""


def load(path: Path | str) -> Model:
    """Read a model file; under `effects` stand those that the simulator has, one without a line is absent.

    Raises ModelFileError when the file cannot be read or says what no robot can be.
    """
    path = Path(path)
    lines: dict[Place, int] = {(): 1}
    try:
        node = yaml.compose(path.read_text(encoding="utf-8"), Loader=_Loader)
        data = {} if node is None else _plain(node, (), lines)
    except OSError as error:
        raise ModelFileError(f"{path}: cannot be read ({error.strerror}); name a model file") from None
    except UnicodeDecodeError:
        raise ModelFileError(f"{path}: is not UTF-8 text; name a model file") from None
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise ModelFileError(f"{path}:{line}: is not valid YAML: {error.problem}; correct it there") from None
    if isinstance(data, dict) and isinstance(data.get("effects"), dict):
        # The schema's defaults are the seed's effects; in a file, taking out a line takes out the effect.
        data["effects"] = dict.fromkeys(_keys(("effects",))) | data["effects"]
    try:
        # By way of JSON, where strict means that a number is a number.
        return Model.model_validate_json(json.dumps(data), strict=True)
    except ValidationError as error:
        problems = [_explain(item, path, lines) for item in error.errors(include_url=False)]
        raise ModelFileError("\n".join(problems)) from None


def save(model: Model, path: Path | str) -> None:
    """Write a model in full; `load` gives back an equal one."""
    # JSON mode, so that tuples are lists; `sort_keys` off, so that the file keeps the order of the schema.
    data = model.model_dump(mode="json", by_alias=True)
    data["effects"] = {name: value for name, value in data["effects"].items() if value is not None}
    text = yaml.dump(data, Dumper=_Dumper, sort_keys=False, width=200)
    Path(path).write_text(_HEADER + text, encoding="utf-8")


class _Dumper(yaml.SafeDumper):
    """One key a line, one line a list."""


_Dumper.add_representer(
    list, lambda dumper, items: dumper.represent_sequence("tag:yaml.org,2002:seq", items, flow_style=True)
)


class _Loader(yaml.SafeLoader):
    """YAML 1.1 as PyYAML reads it, plus the numbers that it takes for texts (1e-3)."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"), list("-+0123456789")
)


def _plain(node: yaml.Node, place: Place, lines: dict[Place, int]) -> Any:
    """Turn a node into plain data and note the line at which each key or item stands."""
    if isinstance(node, yaml.MappingNode):
        data: dict[str, Any] = {}
        for key_node, value_node in node.value:
            key = str(key_node.value)
            if key in data:
                raise yaml.MarkedYAMLError(problem=f"{key} stands twice", problem_mark=key_node.start_mark)
            lines[*place, key] = key_node.start_mark.line + 1
            data[key] = _plain(value_node, (*place, key), lines)
        return data
    if isinstance(node, yaml.SequenceNode):
        for i, item in enumerate(node.value):
            lines[*place, i] = item.start_mark.line + 1
        return [_plain(item, (*place, i), lines) for i, item in enumerate(node.value)]
    value = _Loader("").construct_object(node)
    return value if isinstance(value, str | int | float | bool | None) else str(node.value)


def _explain(item: Mapping[str, Any], path: Path, lines: dict[Place, int]) -> str:
    """Put one finding of pydantic into a line that names file, line and key."""
    place: Place = item["loc"]
    known = place
    while known not in lines:
        known = known[:-1]
    name = ".".join(str(part) for part in place) or "the model"
    if item["type"] == "extra_forbidden":
        allowed = _keys(place[:-1])
        near = difflib.get_close_matches(str(place[-1]), allowed, n=1)
        hint = f"did you mean {near[0]}? allowed" if near else "allowed"
        return f"{path}:{lines[known]}: {name}: unknown key; {hint}: {', '.join(allowed)}"
    given = "" if item["type"] == "value_error" else f" but is {_shown(item['input'])}; change it"
    message = str(item["msg"]).removeprefix("Value error, ").replace("Input should be", "must be")
    return f"{path}:{lines[known]}: {name}: {message}{given}"


def _keys(place: Place) -> list[str]:
    """Return the keys allowed at a place of the file."""
    schema: type[BaseModel] = Model
    for part in place:
        field = next(f for name, f in schema.model_fields.items() if (f.alias or name) == part)
        candidates = (field.annotation, *getattr(field.annotation, "__args__", ()))
        schema = next(c for c in candidates if isinstance(c, type) and issubclass(c, BaseModel))
    return [field.alias or name for name, field in schema.model_fields.items()]


def _shown(value: object) -> str:
    return "a group" if isinstance(value, dict) else "a list" if isinstance(value, list) else repr(value)
