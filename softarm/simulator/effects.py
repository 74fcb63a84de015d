"""Registry of effects, with look-up and validation."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import NamedTuple

from softarm.common.words import did_you_mean
from softarm.common.yaml_lines import ERRORS_MAX
from softarm.schemas.model import Model
from softarm.simulator.effect_table import EFFECTS, RIVALS, STAGES, Effect, Parameter, with_rivals

__all__ = ["REGISTRY", "STAGES", "Effect", "EffectError", "Parameter", "exemplars", "find", "validate", "value"]


class Violation(NamedTuple):
    """An error in a model's effects; the sentence is built on demand."""

    place: tuple[str, ...]  # effect, or effect and parameter
    say: Callable[[], str]


class EffectError(ValueError):
    """Error of invalid effects; `violations` holds all errors, the message the first ones, one a line."""

    def __init__(self, *violations: Violation) -> None:
        super().__init__("\n".join(f"{'.'.join(each.place)}: {each.say()}" for each in violations[:ERRORS_MAX]))
        self.violations = violations


# Effect name -> effect, in causal order.
REGISTRY: dict[str, Effect] = {effect.name: effect for effect in with_rivals(EFFECTS, RIVALS)}


def find(path: str) -> tuple[Effect, Parameter]:
    """Return the effect and the parameter of `stage.effect.parameter`. Raises EffectError if unknown."""
    name, _, parameter = path.rpartition(".")
    if path in REGISTRY:
        raise EffectError(Violation((path,), lambda: f"names no parameter; {path} has {_wanted(REGISTRY[path])}"))
    if name not in REGISTRY:
        raise EffectError(Violation((path,), partial(_unknown, name)))
    for known in REGISTRY[name].parameters:
        if known.name == parameter:
            return REGISTRY[name], known
    raise EffectError(Violation((name, parameter), partial(_unknown_parameter, REGISTRY[name], parameter)))


def value(model: Model, effect: str, parameter: str) -> float:
    """Return a model's value of an effect's parameter, in the parameter's unit; neutral if the effect is absent.

    Raises EffectError for names that the registry does not have.
    """
    known, found = find(f"{effect}.{parameter}")
    if known.name not in model.effects:
        return found.neutral
    return model.effects[known.name].get(parameter, found.otherwise)


def exemplars() -> dict[str, dict[str, float]]:
    """Return the `effects` of a model that has all effects at their strong values."""
    return {name: {p.name: p.exemplar for p in effect.parameters} for name, effect in REGISTRY.items()}


def validate(effects: Mapping[str, Mapping[str, float]]) -> None:
    """Check a model's effects: names, parameters, bounds. Raises EffectError with all errors."""
    if found := list(violations(effects)):
        raise EffectError(*found)


def violations(effects: Mapping[str, Mapping[str, object]]) -> Iterator[Violation]:
    """Yield the errors of a model's effects, in their order."""
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
    """Return the violation of a value outside the bounds of a parameter."""
    return Violation((effect.name, parameter.name), lambda: f"{parameter.complaint(value)}; source: {effect.source}")


def _unknown(name: str) -> str:
    near = [known for known in REGISTRY if known.partition(".")[2] == name.rpartition(".")[2]]  # on another stage
    hint = f"did you mean {near[0]}? " if near else did_you_mean(name, REGISTRY, cutoff=0.5)
    return f"unknown effect; {hint}`python -m softarm.simulator.effects_page` lists them all"


def _unknown_parameter(effect: Effect, name: str) -> str:
    if not effect.parameters:
        return "has no parameters: it is on or absent; write {}"
    hint = did_you_mean(name, [p.name for p in effect.parameters])
    return f"unknown parameter; {hint}{effect.name} has {_wanted(effect)}"


def _without(effect: Effect) -> str:
    return f"names no parameter, so it would change nothing; give {_wanted(effect)}, or remove the line"


def _wanted(effect: Effect) -> str:
    return ", ".join(f"{p.name} ({p.unit})" for p in effect.parameters)
