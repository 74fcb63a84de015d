"""Model files: a robot's parameters and a simulator's effects as YAML, to and from `softarm.schemas.model.Model`."""

import difflib
import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from softarm.schemas.model import Model
from softarm.simulator import effects
from softarm.simulator.effects import REGISTRY
from softarm.simulator.quantities import Range
from softarm.simulator.robot_table import ROBOT
from softarm.simulator.yaml_lines import Document, Place, YamlError, parse

# The shipped models: the seed's simulator, and its four ablations.
MODELS = Path(__file__).parent / "models"
SEED = MODELS / "seed.yaml"

_HEADER = """\
# A robot's parameters, and the effects that its simulator has. A parameter that is left out has the seed's
# value; an effect without a line under `effects` is absent. `softarm model show FILE` tells units and sources.
"""


Key = TypeVar("Key")


class ModelFileError(Exception):
    """All that is wrong with a model file, one `FILE:LINE: key: what is wrong, what is allowed` a line."""


def shipped() -> list[str]:
    """Names of the shipped models."""
    return sorted(path.stem for path in MODELS.glob("*.yaml"))


def locate(name: Path | str) -> Path:
    """Return the file of a model: a shipped name (`no-delay`) or a path. Raises ModelFileError when there is none."""
    name, path = str(name), Path(name)
    if name in shipped():
        return MODELS / f"{name}.yaml"
    if path.exists() or path.suffix or len(path.parts) > 1:
        return path
    near = difflib.get_close_matches(name, shipped(), n=1)
    hint = f"did you mean {near[0]}? " if near else ""
    raise ModelFileError(f"{name}: no such file or model; {hint}name a file, or one of {', '.join(shipped())}")


def load(name: Path | str) -> Model:
    """Read a model by its file or its shipped name.

    Under `effects` stand those that the simulator has, one without a line is absent; a file without `effects` has
    the seed's. Raises ModelFileError when the file cannot be read or says what no robot can be.
    """
    path = locate(name)
    try:
        document = parse(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ModelFileError(f"{path}: cannot be read ({error.strerror}); name a model file") from None
    except UnicodeDecodeError:
        raise ModelFileError(f"{path}: is not UTF-8 text; name a model file") from None
    except YamlError as error:
        raise ModelFileError(
            f"{path}:{error.line}: is not valid YAML: {_one_line(str(error))}; correct it there"
        ) from None
    found = dict(_out_of_range(document.data))
    model = None
    try:
        # By way of JSON, where strict means that a number is a number.
        model = Model.model_validate_json(json.dumps(document.data), strict=True)
    except ValidationError as error:
        for item in error.errors(include_url=False):
            found.setdefault(item["loc"], _explain(item))
    if model is None or found:
        raise ModelFileError("\n".join(_sentences(path, document, found)))
    return model


def save(model: Model, path: Path | str) -> None:
    """Write a model in full; `load` gives back an equal one."""
    # JSON mode, so that tuples are lists; `sort_keys` off, so that the file keeps the order of the schema.
    data = model.model_dump(mode="json", exclude={"effects"})
    data["effects"] = {name: dict(given) for name, given in model.effects.items()}
    text = yaml.dump(data, Dumper=_Dumper, sort_keys=False, width=200)
    Path(path).write_text(_HEADER + text, encoding="utf-8")


def fingerprint(model: Model) -> str:
    """SHA-256 of a model's canonical JSON (keys sorted, no spaces), in hex: equal models have the same."""
    text = json.dumps(model.model_dump(), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


class _Dumper(yaml.SafeDumper):
    """One key a line, one line a list."""


_Dumper.add_representer(
    list, lambda dumper, items: dumper.represent_sequence("tag:yaml.org,2002:seq", items, flow_style=True)
)


def _sentences(path: Path, document: Document, found: Mapping[Place, str]) -> list[str]:
    """One line for each thing that is wrong, in the order of the file."""
    named = ((document.line(place), _name(place), text) for place, text in found.items())
    return [f"{path}:{line}: {_one_line(f'{name}: {text}')}" for line, name, text in sorted(named)]


def _out_of_range(data: Any) -> Iterator[tuple[Place, str]]:
    """Find the numbers and names that are none of a robot's: the ranges of ROBOT, the registry of effects."""
    if not isinstance(data, dict):
        return
    for key, quantity in ROBOT.items():
        group, _, name = key.partition(".")
        given = data[group].get(name) if isinstance(data.get(group), dict) else None
        values: dict[Place, object] = {(group, name): given}
        if isinstance(given, list):
            values = {(group, name, i): item for i, item in enumerate(given)}
        for place, number in _numbers(values).items():
            if not quantity.range.admits(number):
                yield place, f"{quantity.range.complaint(number)}; source of the seed's: {quantity.source}"
    if not isinstance(data.get("effects"), dict):
        return
    for name, given in data["effects"].items():
        numbers = _numbers(given) if isinstance(given, dict) else {}
        if given != {} and not numbers and name in REGISTRY:
            continue  # not a group, or none of its values a number: pydantic's to tell
        for problem in effects.problems({name: numbers}):
            yield ("effects", *problem.place), problem.text


def _numbers(values: Mapping[Key, object]) -> dict[Key, float]:
    """Those of some values that are numbers; a whole one too large for a float is infinite."""
    numbers = {}
    for key, value in values.items():
        if isinstance(value, int | float) and not isinstance(value, bool):
            try:
                numbers[key] = float(value)
            except OverflowError:
                numbers[key] = math.inf
    return numbers


def _explain(item: Mapping[str, Any]) -> str:
    """Put one finding of pydantic into words."""
    place: Place = item["loc"]
    given = item["input"]
    if item["type"] == "extra_forbidden":
        allowed = _keys(place[:-1])
        near = difflib.get_close_matches(str(place[-1]), allowed, n=1)
        hint = f"did you mean {near[0]}? allowed" if near else "allowed"
        return f"unknown key; {hint}: {', '.join(allowed)}"
    if item["type"] == "float_type" and isinstance(given, str) and (range_ := _range(place)):
        return range_.complaint_of_text(given)
    if place[:1] == ("effects",) and len(place) == 2 and given is None:
        return "has nothing behind its colon; write {} or its parameters, or remove the line for an absent effect"
    was = "" if item["type"] == "value_error" else f" but is {_shown(given)}; change it"
    return str(item["msg"]).removeprefix("Value error, ").replace("Input should be", "must be") + was


def _range(place: Place) -> Range | None:
    """The range of the number at a place of the file."""
    if place[:1] == ("effects",):
        parameters = REGISTRY[str(place[1])].parameters if place[1] in REGISTRY else ()
        return next((p.range for p in parameters if p.name == place[2]), None)
    quantity = ROBOT.get(".".join(map(str, place[:2])))
    return quantity.range if quantity else None


def _keys(place: Place) -> list[str]:
    """Return the keys allowed at a place of the file."""
    schema: Any = Model
    for part in place:
        schema = schema.model_fields[part].annotation
    assert issubclass(schema, BaseModel)
    return list(schema.model_fields)


def _name(place: Place) -> str:
    return ".".join(map(str, place)) or "the model"


def _one_line(text: str) -> str:
    return " ".join(text.split())  # keys of a file may be of several


def _shown(value: object) -> str:
    return "a group" if isinstance(value, dict) else "a list" if isinstance(value, list) else repr(value)
