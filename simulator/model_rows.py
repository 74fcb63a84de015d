"""A model as rows of text and numbers: what `softarm model show` and `diff` print."""

from collections.abc import Iterator
from typing import NamedTuple

from softarm.schemas.model import Model
from softarm.simulator import effects
from softarm.simulator.robot_table import ROBOT

ABSENT = "absent"


class Row(NamedTuple):
    """One parameter as it is in force."""

    key: str  # `cart.mass_kg`, `rail.delay.delay`
    numbers: tuple[float, ...]  # of a list one a link, of an effect without parameters none
    unit: str  # `-`: a pure number
    allowed: str
    source: str

    @property
    def value(self) -> str:
        """The numbers to six digits."""
        return ", ".join(f"{number:.6g}" for number in self.numbers) or "on"


def robot_rows(model: Model) -> Iterator[Row]:
    """Every parameter of arm and cart, with the source of the seed's value."""
    for key, quantity in ROBOT.items():
        group, _, name = key.partition(".")
        value = getattr(getattr(model, group), name)
        numbers = value if isinstance(value, tuple) else (value,)
        yield Row(key, numbers, quantity.unit, str(quantity), quantity.source)


def effect_rows(model: Model) -> Iterator[Row]:
    """Every parameter of the effects that the model has, defaults filled in."""
    for name, effect in effects.REGISTRY.items():
        if name not in model.effects:
            continue
        if not effect.parameters:
            yield Row(name, (), "", "", effect.source)
        for p in effect.parameters:
            value = effects.value(model, name, p.name)
            yield Row(f"{name}.{p.name}", (value,), p.unit, str(p), effect.source)


def idle_effects(model: Model) -> list[str]:
    """Effects that a model has at their neutral value: they change nothing."""
    idle = []
    for name in model.effects:
        parameters = [p for p in effects.REGISTRY[name].parameters if p.default is None]
        if parameters and all(effects.value(model, name, p.name) == p.neutral for p in parameters):
            idle.append(name)
    return idle


class Difference(NamedTuple):
    """One parameter that two models have different; `absent` where one lacks the effect."""

    key: str
    unit: str
    one: str
    other: str


def differences(one: Model, other: Model) -> list[Difference]:
    """List what differs between two models, in the order of robot and registry."""
    tables = [{row.key: row for row in (*robot_rows(model), *effect_rows(model))} for model in (one, other)]
    found = []
    for key in _all_keys():
        rows = [table.get(key) for table in tables]
        if (present := next((row for row in rows if row), None)) is None:
            continue
        if len({row and row.numbers for row in rows}) == 2:
            texts = [row.value if row else ABSENT for row in rows]
            if texts[0] == texts[1]:  # the same to six digits
                texts = [", ".join(map(repr, row.numbers)) for row in rows if row]
            found.append(Difference(key, present.unit, *texts))
    return found


def _all_keys() -> Iterator[str]:
    yield from ROBOT
    for name, effect in effects.REGISTRY.items():
        yield from (f"{name}.{p.name}" for p in effect.parameters) if effect.parameters else (name,)
