"""Laws and values of the nominal model that a view settles before its search, or that a search shows."""

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from softarm.diagnosis.engine.candidates import Candidate, Coordinates, EffectSet
from softarm.diagnosis.engine.examination import Examination
from softarm.diagnosis.engine.fits import FitProblem
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.thresholds import RIG
from softarm.diagnosis.rigs.candidates import candidates, setup_of
from softarm.diagnosis.rigs.views import RigView

# Effects that a curved parameter is settled beside, and the rounds of their fits.
LIKELY, SETTLING_ROUNDS = 4, 3
# Energy of a gap above its noise, per sample, below which two gaps count as equal.
SAME = 0.25
# Share of the squared gap that remains next to such an effect at most, if it explains most of the gap; and with another
# law of the nominal model, if that law is used.
MOST = 0.5
# Fewest stages that determine a law together.
STAGES_LEAST = 3
# A search is repeated around its best fit if tolerated parameters that act linearly leave so many times the loss, and
# its answer counts if it leaves at most as much.
BENT = 1.5


def settled(
    view: RigView, kinds: Sequence[str], origins: Sequence[int], law: int | None = None
) -> tuple[Setup, tuple[float, ...]]:
    """Return the problem of a view, and the energy of the gap per sample with each of its laws.

    The view gets the law and the value of each curved parameter that leave the smallest gap. A given law is used as it
    is, without energies, as is the only one of a view. If one effect explains most of the gap, that is the smallest gap
    next to this effect; alone, the parameter would replace a part of the effect.
    """

    def setup() -> Setup:
        return setup_of(view, kinds, origins)

    def least(path: str, value: float, sets: Sequence[tuple[EffectSet, Coordinates]]) -> float:
        view.assume(path, value)
        return min(fit.loss for fit in setup().plain().fit(sets, SETTLING_ROUNDS))

    samples = int(np.isfinite(view.measured).sum())
    for path, values in view.curved.items():
        alone = [least(path, value, [((), ())]) for value in values]
        best = values[int(np.argmin(alone))]
        view.assume(path, best)
        if min(alone) > RIG.gain.ignored * samples:
            likely = _likely(setup().plain(), [c for c in candidates(view) if not _owns(c, path)])
            beside = [least(path, value, likely) for value in values]
            if min(beside) < MOST * min(alone):
                best = values[int(np.argmin(beside))]
            view.assume(path, best)
    losses: tuple[float, ...] = ()
    if len(view.laws) > 1:
        if law is None:
            losses = _losses(view, setup)
            law = chosen_law(losses)
        law = min(law, len(view.laws) - 1)
        view.assume_all(view.laws[law])
        if law:  # the noise was measured next to the usual law
            view.measure_noise()
    return setup(), losses


def resumed(found: Examination, examined: Callable[[Setup], Examination]) -> Examination:
    """Return a search around the best fit of one without an answer if it explains as much, else the first search.

    A published viscous friction was usually fitted as the only one. Beside dry friction and drag it vanishes, which its
    slope at the published value does not show.

    Args:
        found: search with tolerated parameters that act linearly around the nominal model.
        examined: searches a problem.
    """
    problem, fits = found.search.problem, found.search.fitted
    if found.choice.chosen.effects or not fits:
        return found
    best = min(fits, key=lambda fit: fit.loss)
    beyond = [i for i, (each, u) in enumerate(zip(best.effects, best.u, strict=True)) if each.exceeds_tolerance(u)]
    if len(beyond) in (0, len(best.effects)):
        return found
    linear = problem.part(best, beyond)
    if linear.loss <= BENT * best.loss:
        return found
    again = examined(found.setup.beside(linear))
    chosen = again.choice.chosen
    return again if chosen.effects and chosen.loss <= BENT * best.loss else found


def common_law(losses: Sequence[Sequence[float]]) -> int | None:
    """Return the number of the unusual law that a simulation gave all stages of a mechanism, or None.

    One stage alone may take an effect of its own for a part of such a law. The median stage has no effect, and the
    right law leaves no more than noise there.

    Args:
        losses: energies of each stage's gap per sample, by law; those of a stage that shows fewer laws do not count.
    """
    most = max(map(len, losses), default=0)
    full = np.array([each for each in losses if len(each) == most])
    if most < 2 or len(full) < STAGES_LEAST:
        return None
    middle = np.median(full, axis=0)
    chosen = chosen_law(middle, len(full))
    return chosen if chosen and middle[chosen] < 1 + SAME else None


def chosen_law(losses: Sequence[float], stages: int = 1) -> int:
    """Return the number of the law that leaves the smallest gap, or 0 if the usual one leaves about as much.

    losses: energies by law, of the median of some stages.
    """
    same = SAME / math.sqrt(stages)
    usual, least = (max(loss - 1.0, same) for loss in (losses[0], min(losses)))
    return int(np.argmin(losses)) if least < MOST * usual else 0


def is_other_law(losses: Sequence[float], law: int, *, has_cause: bool) -> bool:
    """Return whether a stage chose another law than the common one, which would change its answer.

    Args:
        losses: energies of its gap per sample, by law.
        law: number of the common law.
        has_cause: whether the stage has a gap; a healthy stage stays healthy if the common law leaves noise.
    """
    if len(losses) < 2 or chosen_law(losses) == law:
        return False
    return has_cause or losses[min(law, len(losses) - 1)] > 1 + SAME


def _losses(view: RigView, setup: Callable[[], Setup]) -> tuple[float, ...]:
    """Return the energy of the gap per sample with each law of a view.

    The gap next to an effect counts if the effect explains most of it, and more than one that needs no effect.
    """
    samples = int(np.isfinite(view.measured).sum())

    def left(law: Mapping[str, float]) -> float:
        view.assume_all(law)
        problem = setup().plain()
        alone, explained = (
            min(fit.loss for fit in problem.fit(sets, SETTLING_ROUNDS)) / samples
            for sets in ([((), ())], _likely(problem, candidates(view)))
        )
        return min(alone, explained / MOST)

    return tuple(left(law) for law in view.laws)


def _owns(candidate: Candidate, path: str) -> bool:
    return any(parameter.path.endswith(f".{path}") for parameter in candidate.parameters)


def _likely(problem: FitProblem, known: Sequence[Candidate]) -> list[tuple[EffectSet, Coordinates]]:
    """Return the effects that explain most, each as a set of its own with its first fit."""
    sets: list[tuple[EffectSet, Coordinates]] = [((each,), (start,)) for each in known for start in each.starts]
    begun: dict[str, tuple[EffectSet, Coordinates]] = {}
    for _, (effects, u) in sorted(zip(problem.losses(sets), sets, strict=True), key=lambda each: each[0]):
        begun.setdefault(effects[0].name, (effects, u))
    fits = sorted(problem.fit([*begun.values()], SETTLING_ROUNDS), key=lambda fit: fit.loss)
    return [(fit.effects, fit.u) for fit in fits[:LIKELY]]
