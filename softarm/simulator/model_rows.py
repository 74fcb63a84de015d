"""Rows of a model's parameters for `softarm model show` and `diff`."""

from collections.abc import Iterator
from typing import NamedTuple

from softarm.schemas.model import Model
from softarm.simulator import effects
from softarm.simulator.robot_table import ROBOT

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
