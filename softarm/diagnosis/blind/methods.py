"""Methods of the benchmark: the diagnosis and simpler baselines, all with the same inputs."""

from collections.abc import Callable, Sequence
from functools import partial

from softarm.diagnosis.data.trials import Trial
from softarm.diagnosis.engine.result import Diagnosis
from softarm.schemas.model import Model
from softarm.schemas.verdict import Verdict

Method = Callable[[Sequence[Trial], Model], Verdict | Diagnosis]


# Imports are local, because each method loads numba and SciPy and `softarm blind make` needs neither.
def _diagnose(trials: Sequence[Trial], model: Model) -> Diagnosis:
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
