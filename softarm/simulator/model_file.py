"""Model files: a robot's parameters and a simulator's effects as YAML, and as rows of `softarm model show` and `diff`.

Default values are in `softarm.schemas.model`.
Sources: [P] the CoRL 2023 paper (sections; SM: its supplement), [C] its authors' released configuration.
"""

import hashlib
import json
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from softarm.common import files, yaml_lines
from softarm.common.quantity import Quantity
from softarm.common.words import did_you_mean
from softarm.common.yaml_lines import FileError, Place
from softarm.common.yaml_schema import fit
from softarm.schemas.model import Model
from softarm.simulator import effects


def _row(name: str, unit: str, low: float, high: float, source: str) -> Quantity:
    return Quantity(name=name, unit=unit, low=low, high=high, source=source)


_ROWS = (
    _row("arm.link_length_m", "m", 0.005, 1.0, "[C]; [P] SM-E: 0.44 m in all"),
    _row("arm.link_mass_kg", "kg", 1e-4, 2.0, "[C], and the total of [P] SM-E: 0.12 kg"),
    _row("arm.link_inertia_kg_m2", "kg m^2", 1e-9, 0.1, "[C]: thin shells and a solid tip"),
    _row("arm.stiffness_nm_rad", "N m/rad", 0.0, 50.0, "[P] SM-B, [C]"),
    _row("arm.damping_nm_s_rad", "N m s/rad", 0.0, 5.0, "[P] SM-B, [C]"),
    _row("arm.muscle_gain_nm_kpa", "N m/kPa", -0.02, 0.02, "[P] SM-B and [C], there in N m/psi"),
    _row("arm.torque_offset_nm", "N m", -0.5, 0.5, "[C] only; [P] leaves it out"),
    _row("arm.base_height_m", "m", 0.0, 10.0, "[C]"),
    _row("arm.gravity_m_s2", "m/s^2", 0.0, 30.0, "standard gravity"),
    _row("cart.mass_kg", "kg", 0.01, 50.0, "[C]"),
    _row("cart.feedforward_mass_kg", "kg", 0.0, 50.0, "[C]; [P] section 3.3: the mass of the robot"),
    _row("cart.acceleration_gain_kg", "kg", 0.0, 50.0, "[P] SM-E, [C]"),
    _row("cart.velocity_gain_n_s_m", "N s/m", 0.0, 10000.0, "[P] SM-E, [C]"),
    _row("cart.tracking_switch_m_s", "m/s", 0.0, 10.0, "[P] section 3.3"),
    _row("cart.travel_m", "m", 0.01, 100.0, "[P] SM-E: 0.6 m in all"),
)
# Name -> parameter of arm or cart; for a list, the bounds of each entry.
ROBOT = {quantity.name: quantity for quantity in _ROWS}


ABSENT = "absent"


class Row(NamedTuple):
    """One parameter with its value in force."""

    key: str  # `cart.mass_kg`, `rail.delay.delay`
    numbers: tuple[float, ...]  # one a link for a list; empty for an effect without parameters
    unit: str  # `-`: a pure number
    allowed: str
    source: str

    @property
    def value(self) -> str:
        """Return the numbers with six digits, or `on`."""
        return ", ".join(f"{number:.6g}" for number in self.numbers) or "on"


def robot_rows(model: Model) -> Iterator[Row]:
    """Yield every parameter of arm and cart, with the source of the seed's value."""
    for key, quantity in ROBOT.items():
        group, _, name = key.partition(".")
        value = getattr(getattr(model, group), name)
        numbers = value if isinstance(value, tuple) else (value,)
        yield Row(key, numbers, quantity.unit, str(quantity), quantity.source)


def effect_rows(model: Model) -> Iterator[Row]:
    """Yield every parameter of the model's effects, defaults included."""
    for name, effect in effects.REGISTRY.items():
        if name not in model.effects:
            continue
        if not effect.parameters:
            yield Row(name, (), "", "", effect.source)
        for p in effect.parameters:
            value = effects.value(model, name, p.name)
            yield Row(f"{name}.{p.name}", (value,), p.unit, str(p), effect.source)


def idle_effects(model: Model) -> list[str]:
    """Return the effects at their neutral value, which change nothing."""
    idle = []
    for name in model.effects:
        parameters = [p for p in effects.REGISTRY[name].parameters if p.default is None]
        if parameters and all(effects.value(model, name, p.name) == p.neutral for p in parameters):
            idle.append(name)
    return idle


class Difference(NamedTuple):
    """One parameter that differs between two models; `absent` if one lacks the effect."""

    key: str
    unit: str
    one: str
    other: str


def differences(one: Model, other: Model) -> list[Difference]:
    """Return the differences between two models, in the order of robot and registry."""
    # The last model has every row, in the order of robot and registry.
    models = (one, other, Model(effects=effects.exemplars()))
    *tables, every = ({row.key: row for row in (*robot_rows(model), *effect_rows(model))} for model in models)
    found = []
    for key in every:
        rows = [table.get(key) for table in tables]
        if len({row and row.numbers for row in rows}) == 2:
            texts = [row.value if row else ABSENT for row in rows]
            if texts[0] == texts[1]:  # the same to six digits
                texts = [", ".join(map(repr, row.numbers)) for row in rows if row]
            found.append(Difference(key, every[key].unit, *texts))
    return found


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
    if files.exists(path) or path.suffix or len(path.parts) > 1:
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
