"""Model files: a robot's parameters and a simulator's effects as YAML, to and from `softarm.schemas.model.Model`."""

import hashlib
import json
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import yaml

from softarm.common import files, yaml_lines
from softarm.common.quantity import Quantity
from softarm.common.words import did_you_mean
from softarm.common.yaml_lines import FileError, Place
from softarm.common.yaml_schema import fit
from softarm.schemas.model import Model
from softarm.simulator import effects
from softarm.simulator.robot_table import ROBOT

# The shipped models: the seed's simulator, and its four ablations.
MODELS = Path(__file__).parent / "models"
SEED = MODELS / "seed.yaml"

_HEADER = """\
# A robot's parameters, and the effects that its simulator has. A parameter that is left out has the seed's
# value; an effect without a line under `effects` is absent. `softarm model show FILE` shows units and sources.
"""
_NOTHING = "has no value; write {} or its parameters, or remove the line for an absent effect"


class ModelFileError(Exception):
    """Errors of a model file, one `FILE:LINE: key: error, allowed values` a line."""


def shipped() -> list[str]:
    """Return the names of the shipped models."""
    return sorted(path.stem for path in MODELS.glob("*.yaml"))


def locate(name: Path | str) -> Path:
    """Return the file of a model: a shipped name (`no-delay`) or a path. Raises ModelFileError if there is none."""
    name, path = str(name), Path(name)
    if name in shipped():
        return MODELS / f"{name}.yaml"
    if path.exists() or path.suffix or len(path.parts) > 1:
        return path
    hint = did_you_mean(name, shipped())
    raise ModelFileError(f"{name}: no such file or model; {hint}name a file, or one of {', '.join(shipped())}")


def load(name: Path | str) -> Model:
    """Read a model by its file or its shipped name.

    Effects that are not listed under `effects` are absent; a file without `effects` has the seed's. Raises
    ModelFileError if the file cannot be read or is invalid.
    """
    try:
        document = yaml_lines.read(locate(name), "name a model file")
        return fit(document, Model, dict(_findings(document.data)))
    except FileError as error:
        raise ModelFileError(str(error)) from None


def save(model: Model, path: Path | str) -> None:
    """Write all keys of a model, so that `load` returns an equal one."""
    files.write_text(path, text(model))


def text(model: Model) -> str:
    """Return the content of a model's file."""
    # JSON mode, so that tuples are lists; `sort_keys` off, so that the file keeps the order of the schema.
    data = model.model_dump(mode="json", exclude={"effects"})
    data["effects"] = {name: dict(given) for name, given in model.effects.items()}
    return _HEADER + yaml.dump(data, Dumper=_Dumper, sort_keys=False, width=200)


def fingerprint(model: Model) -> str:
    """Return the SHA-256 of a model's canonical JSON (keys sorted, no spaces), in hex."""
    text = json.dumps(model.model_dump(), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


class _Dumper(yaml.SafeDumper):
    """YAML dumper that writes one key a line and each list on one line."""


_Dumper.add_representer(
    list, lambda dumper, items: dumper.represent_sequence("tag:yaml.org,2002:seq", items, flow_style=True)
)


def _findings(data: Any) -> Iterator[tuple[Place, Callable[[], str]]]:
    """Yield invalid numbers and unknown names, by the quantities of ROBOT and the registry of effects."""
    if not isinstance(data, dict):
        return
    for key, quantity in ROBOT.items():
        group, _, name = key.partition(".")
        given = data.get(group)
        if not isinstance(given, dict) or name not in given:
            continue
        many = isinstance(given[name], list)
        for place, value in [((i,), each) for i, each in enumerate(given[name])] if many else [((), given[name])]:
            if not quantity.takes(value):
                yield (group, name, *place), partial(_complaint, quantity, value)
    if isinstance(data.get("effects"), dict):
        for name, given in data["effects"].items():
            if given is None:
                yield ("effects", name), lambda: _NOTHING
            elif isinstance(given, dict):
                for violation in effects.violations({name: given}):
                    yield ("effects", *violation.place), violation.say


def _complaint(quantity: Quantity, value: object) -> str:
    return f"{quantity.complaint(value)}; source of the seed's: {quantity.source}"
