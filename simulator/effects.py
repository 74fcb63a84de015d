"""The registry of effects: what a simulator can have or lack. Everything that speaks of an effect reads it here.

`python -m softarm.simulator.effects` prints docs/effects.md.
"""

import difflib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

from softarm.schemas.model import Model
from softarm.simulator.effect_table import EFFECTS, RIVALS, STAGES, Effect, Parameter

__all__ = ["REGISTRY", "STAGES", "Effect", "EffectError", "Parameter", "exemplars", "find", "validate", "value"]


class Problem(NamedTuple):
    """What is wrong with a model's effects, and with which of them."""

    place: tuple[str, ...]  # effect, or effect and parameter
    text: str


class EffectError(ValueError):
    """Effects that no simulator has; `problems` holds all that is wrong, the message one a line."""

    def __init__(self, problems: list[Problem]) -> None:
        super().__init__("\n".join(f"{'.'.join(problem.place)}: {problem.text}" for problem in problems))
        self.problems = tuple(problems)


def _registry() -> dict[str, Effect]:
    rivals: dict[str, dict[str, str]] = {effect.name: {} for effect in EFFECTS}
    for one, other, separated_by in RIVALS:
        rivals[one][other] = rivals[other][one] = separated_by
    return {
        effect.name: replace(
            effect,
            confused_with=tuple(rivals[effect.name]),
            separated_by="; ".join(f"{name}: {how}" for name, how in rivals[effect.name].items()),
        )
        for effect in EFFECTS
    }


# Effect name -> effect, in causal order.
REGISTRY: dict[str, Effect] = _registry()


def find(path: str) -> tuple[Effect, Parameter]:
    """Return the effect and the parameter of `stage.effect.parameter`. Raises EffectError when there is none."""
    name, _, parameter = path.rpartition(".")
    if name not in REGISTRY:
        raise EffectError([Problem((path,), _unknown(name))])
    return REGISTRY[name], _parameter(REGISTRY[name], parameter)


def value(model: Model, effect: str, parameter: str) -> float:
    """Return what a model says of an effect's parameter, in the parameter's unit; neutral where the effect is absent.

    Raises EffectError for names that the registry does not have.
    """
    known, found = find(f"{effect}.{parameter}")
    if known.name not in model.effects:
        return found.neutral
    return model.effects[known.name].get(parameter, found.otherwise)


def exemplars() -> dict[str, dict[str, float]]:
    """Return every effect at its strong value: a model's `effects` with all of them on."""
    return {name: {p.name: p.exemplar for p in effect.parameters} for name, effect in REGISTRY.items()}


def validate(effects: Mapping[str, Mapping[str, float]]) -> None:
    """Check a model's effects: names, parameters, bounds. Raises EffectError with everything that is wrong."""
    if found := list(problems(effects)):
        raise EffectError(found)


def problems(effects: Mapping[str, Mapping[str, float]]) -> Iterator[Problem]:
    """Find what is wrong with a model's effects, in their order."""
    for name, given in effects.items():
        effect = REGISTRY.get(name)
        if effect is None:
            yield Problem((name,), _unknown(name))
            continue
        if effect.parameters and not given:
            wanted = ", ".join(f"{p.name} ({p.unit})" for p in effect.parameters)
            yield Problem((name,), f"names no parameter, so it would change nothing; give {wanted}, or remove the line")
        for parameter, number in given.items():
            try:
                known = _parameter(effect, parameter)
            except EffectError as error:
                yield error.problems[0]
                continue
            if not known.range.admits(number):
                yield Problem((name, parameter), f"{known.range.complaint(number)}; source: {effect.source}")


def _parameter(effect: Effect, name: str) -> Parameter:
    known = {p.name: p for p in effect.parameters}
    if name in known:
        return known[name]
    if not known:
        text = "has no parameters: it is on or absent; write {}"
    else:
        near = difflib.get_close_matches(name, known, n=1)
        hint = f"did you mean {near[0]}? " if near else ""
        wanted = ", ".join(f"{p.name} ({p.unit})" for p in effect.parameters)
        text = f"unknown parameter; {hint}{effect.name} has {wanted}"
    raise EffectError([Problem((effect.name, name), text)])


def _unknown(name: str) -> str:
    near = [known for known in REGISTRY if known.partition(".")[2] == name.rpartition(".")[2]]  # on another stage
    near = near or difflib.get_close_matches(name, REGISTRY, cutoff=0.5)
    hint = f"did you mean {near[0]}? " if near else ""
    return f"unknown effect; {hint}docs/effects.md lists them all"


if __name__ == "__main__":
    from softarm.simulator.effects_page import page

    print(page(), end="")
