"""Methods of the benchmark: the diagnosis and simpler baselines, all with the same inputs."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Protocol

from softarm.diagnosis.data.trials import Trial
from softarm.schemas.model import Model
from softarm.schemas.verdict import Verdict


class Diagnosed(Protocol):
    """Answer of a method that also returns a patched model."""

    @property
    def verdict(self) -> Verdict:
        """Verdict on the trials."""

    @property
    def patched(self) -> Model | None:
        """Nominal model with the named effects, or None if no effect was named."""

    @property
    def margins(self) -> Mapping[str, float]:
        """Named effect -> distance of its best rival, for its confidence."""


Method = Callable[[Sequence[Trial], Model], Verdict | Diagnosed]


# Imports are local, because each method loads numba and SciPy and `softarm blind make` needs neither.
def _diagnose(trials: Sequence[Trial], model: Model) -> Diagnosed:
    from softarm.diagnosis.diagnose import diagnose

    return diagnose(trials, model)


def _baseline(name: str, trials: Sequence[Trial], model: Model) -> Verdict:
    from softarm.diagnosis import baselines

    verdict: Verdict = getattr(baselines, name)(trials, model)
    return verdict


DEFAULT = "diagnose"
METHODS: dict[str, Method] = {
    DEFAULT: _diagnose,
    "largest-gain": partial(_baseline, "largest_gain"),  # the effect that explains most
    "bic": partial(_baseline, "bic"),  # forward selection by BIC
    "all-at-once": partial(_baseline, "all_at_once"),  # all effects fitted, ranked by value over interval
}


def patched(model: Model, verdict: Verdict) -> Model:
    """Return the nominal model with the named effects, for an answer without a patched model."""
    named = {
        effect.name: {name: estimate.value for name, estimate in effect.parameters.items()}
        for effect in verdict.effects
    }
    return model.model_copy(update={"effects": {**model.effects, **named}})
