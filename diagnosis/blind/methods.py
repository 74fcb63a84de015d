"""Who answers: the diagnosis itself, and simpler rules under the same protocol. No method sees more than another."""

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from softarm.diagnosis.data.trials import Trial
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

    @property
    def margins(self) -> Mapping[str, float]:
        """Of what was named, how far the best rival is behind."""


Method = Callable[[Sequence[Trial], Model], Verdict | Diagnosed]


# Imported when they are called: each brings numba, SciPy and more, and `softarm blind make` needs none of it.


def _diagnose(trials: Sequence[Trial], model: Model) -> Diagnosed:
    from softarm.diagnosis.diagnose import diagnose

    return diagnose(trials, model)


def _largest_gain(trials: Sequence[Trial], model: Model) -> Verdict:
    from softarm.diagnosis.baselines import largest_gain

    return largest_gain(trials, model)


def _bic(trials: Sequence[Trial], model: Model) -> Verdict:
    from softarm.diagnosis.baselines import bic

    return bic(trials, model)


def _all_at_once(trials: Sequence[Trial], model: Model) -> Verdict:
    from softarm.diagnosis.baselines import all_at_once

    return all_at_once(trials, model)


DEFAULT = "diagnose"
METHODS: dict[str, Method] = {
    DEFAULT: _diagnose,
    "largest-gain": _largest_gain,  # the one effect that gains most over nominal
    "bic": _bic,  # forward selection by BIC alone
    "all-at-once": _all_at_once,  # all fitted, ranked by value over interval
}


def patched(model: Model, verdict: Verdict) -> Model:
    """The nominal model with the named effects, for an answer that brings none of its own."""
    named = {
        effect.name: {name: estimate.value for name, estimate in effect.parameters.items()}
        for effect in verdict.effects
    }
    return model.model_copy(update={"effects": {**model.effects, **named}})
