"""Who answers: the diagnosis itself, and simpler rules under the same protocol. No method sees more than another."""

from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Protocol

from softarm.diagnosis.trials import Trial
from softarm.schemas.model import Model
from softarm.schemas.verdict import Verdict


class Diagnosed(Protocol):
    """An answer that brings the model that it would use."""

    @property
    def verdict(self) -> Verdict:
        """What is said."""

    @property
    def patched(self) -> Model | None:
        """The nominal model with what was named; None where nothing was."""


Method = Callable[[Sequence[Trial], Model], Verdict | Diagnosed]


def _target(where: str) -> Method:
    """A function by `module:name`, imported when it is called: each brings libraries of its own."""

    def method(trials: Sequence[Trial], model: Model) -> Verdict | Diagnosed:
        module, _, name = where.partition(":")
        answer: Verdict | Diagnosed = getattr(import_module(module), name)(trials, model)
        return answer

    return method


DEFAULT = "diagnose"
METHODS: dict[str, Method] = {
    DEFAULT: _target("softarm.diagnosis.diagnose:diagnose"),
    "largest-gain": _target("softarm.diagnosis.baselines:largest_gain"),  # the one effect that gains most over nominal
    "bic": _target("softarm.diagnosis.baselines:bic"),  # forward selection by BIC alone
    "all-at-once": _target("softarm.diagnosis.baselines:all_at_once"),  # all fitted, ranked by value over interval
}


def patched(model: Model, verdict: Verdict) -> Model:
    """The nominal model with the named effects, for an answer that brings none of its own."""
    named = {
        effect.name: {name: estimate.value for name, estimate in effect.parameters.items()}
        for effect in verdict.effects
    }
    return model.model_copy(update={"effects": {**model.effects, **named}})
