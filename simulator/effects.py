"""The registry of effects: what a simulator can have or lack. Everything that speaks of an effect reads it here."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import NamedTuple

from softarm.common.words import did_you_mean
from softarm.common.yaml_lines import MAX_TOLD
from softarm.schemas.model import Model
from softarm.simulator.effect_table import EFFECTS, RIVALS, STAGES, Effect, Parameter

__all__ = ["REGISTRY", "STAGES", "Effect", "EffectError", "Parameter", "exemplars", "find", "validate", "value"]


class Violation(NamedTuple):
    """What is wrong with a model's effects, and with which of them. The words are made when they are told."""

    place: tuple[str, ...]  # effect, or effect and parameter
    say: Callable[[], str]


class EffectError(ValueError):
    """Effects that no simulator has; `violations` holds all that is wrong, the message the first, one a line."""

    def __init__(self, *violations: Violation) -> None:
        super().__init__("\n".join(f"{'.'.join(each.place)}: {each.say()}" for each in violations[:MAX_TOLD]))
        self.violations = violations


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
        raise EffectError(Violation((path,), partial(_unknown, name)))
    for known in REGISTRY[name].parameters:
        if known.name == parameter:
            return REGISTRY[name], known
    raise EffectError(Violation((name, parameter), partial(_unknown_parameter, REGISTRY[name], parameter)))


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
    if found := list(violations(effects)):
        raise EffectError(*found)


def violations(effects: Mapping[str, Mapping[str, object]]) -> Iterator[Violation]:
    """Find what is wrong with a model's effects, in their order."""
    for name, given in effects.items():
        effect = REGISTRY.get(name)
        if effect is None:
            yield Violation((name,), partial(_unknown, name))
            continue
        if effect.parameters and not given:
            yield Violation((name,), partial(_without, effect))
        for parameter, value in given.items():
            known = next((p for p in effect.parameters if p.name == parameter), None)
            if known is None:
                yield Violation((name, parameter), partial(_unknown_parameter, effect, parameter))
            elif not known.takes(value):
                yield out_of_range(effect, known, value)


def out_of_range(effect: Effect, parameter: Parameter, value: object) -> Violation:
    """Say of a parameter's value that it is not allowed."""
    return Violation((effect.name, parameter.name), lambda: f"{parameter.complaint(value)}; source: {effect.source}")


def _unknown(name: str) -> str:
    near = [known for known in REGISTRY if known.partition(".")[2] == name.rpartition(".")[2]]  # on another stage
    hint = f"did you mean {near[0]}? " if near else did_you_mean(name, REGISTRY, cutoff=0.5)
    return f"unknown effect; {hint}docs/effects.md lists them all"


def _unknown_parameter(effect: Effect, name: str) -> str:
    if not effect.parameters:
        return "has no parameters: it is on or absent; write {}"
    hint = did_you_mean(name, [p.name for p in effect.parameters])
    return f"unknown parameter; {hint}{effect.name} has {_wanted(effect)}"


def _without(effect: Effect) -> str:
    return f"names no parameter, so it would change nothing; give {_wanted(effect)}, or remove the line"


def _wanted(effect: Effect) -> str:
    return ", ".join(f"{p.name} ({p.unit})" for p in effect.parameters)
