"""Best fit of a stage: the effects that predict its whole recordings best, named or not; a model, no diagnosis.

The search fits windows that begin at the measured motion. How well a set predicts windows says little about whole
recordings: of all sets that the search has fitted, the one that predicts the recordings best is fitted to these again.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from softarm.diagnosis.answer.evidence import rms
from softarm.diagnosis.engine.fits import Fit
from softarm.diagnosis.engine.view import Array, Point
from softarm.diagnosis.rigs.candidates import setup_of
from softarm.diagnosis.rigs.subsample import Stretches
from softarm.diagnosis.rigs.views import RigView
from softarm.schemas.verdict import BestFit, Quantity

# Rounds of a fit to whole recordings, which begins at one to their windows.
ROUNDS = 6
# Sets that are simulated together.
TOGETHER = 16
# RMS over the smallest one within which a set is fitted to whole recordings, and within which fewer effects are better.
FAR, NEAR = 2.0, 1.1

# Returns the unit of a parameter by its path.
Unit = Callable[[str], str]


def best_fit(
    view: RigView, recordings: Stretches, fits: Sequence[Fit], named: Fit, usual: Point, unit: Unit
) -> BestFit | None:
    """Return effects fitted to whole recordings, or None if the named ones predict these as well.

    Args:
        view: view of all recordings.
        recordings: its windows.
        fits: sets of effects fitted to windows.
        named: fit of the named effects.
        usual: the named effects with the calibration.
        unit: returns the unit of a parameter by its path.
    """
    runs = view.uninterrupted()
    sets = _predicting(runs, [fit for fit in fits if fit.effects and not _laws(fit) & view.shared])
    if not sets:
        return None
    problem = setup_of(runs, recordings.kinds, recordings.origins).plain()
    still = np.zeros_like(problem.nuisance_low)  # a model has no calibration besides its effects
    problem = replace(problem, nuisance_low=still, nuisance_high=still, simulated=True)
    tuned = problem.fit([(each.effects, each.u) for each in sets], ROUNDS)
    most = NEAR**2 * min(_held_out(fit) for fit in tuned)
    best = min((fit for fit in tuned if _held_out(fit) <= most), key=lambda fit: (len(fit.effects), _held_out(fit)))
    held = {path: view.nominal(path.partition(".")[2]) for path in view.original}
    values = {path: x for path, x in {**held, **best.point}.items() if math.isfinite(x)}
    nominal, others, left = runs.gap([view.original, usual, values]).astype(float)
    after = rms(left) * math.sqrt(_held_out(best) / max(best.loss, 1e-12))
    if (after >= rms(others) and not _laws(named) & view.shared) or _worsens(runs, nominal, left, recordings.origins):
        return None
    return BestFit(
        parameters={path: Quantity(value=x, unit=unit(path)) for path, x in values.items()},
        before=Quantity(value=rms(nominal), unit=view.unit),
        after=Quantity(value=after, unit=view.unit),
    )


def _predicting(runs: RigView, fits: Sequence[Fit]) -> list[Fit]:
    """Return the fit of each number of effects that predicts whole recordings best, without far worse ones."""
    best = dict[int, tuple[float, Fit]]()
    for first in range(0, len(fits), TOGETHER):
        some = fits[first : first + TOGETHER]
        for fit, gap in zip(some, runs.gap([fit.point for fit in some]), strict=True):
            left = rms(gap.astype(float))
            if left < best.get(len(fit.effects), (math.inf, fit))[0]:
                best[len(fit.effects)] = left, fit
    most = FAR * min((left for left, _ in best.values()), default=0.0)
    return [fit for left, fit in best.values() if left <= most]


def _held_out(fit: Fit) -> float:
    """Return the loss of all blocks, each from a fit without its fold, at least that of the fit to all."""
    return max(float(fit.held_out.sum()), fit.loss)


def _laws(fit: Fit) -> set[str]:
    """Return the laws of a fit's effects."""
    return {name.rpartition(".")[2] for name in fit.names}


def _worsens(view: RigView, nominal: Array, left: Array, origins: Sequence[int]) -> bool:
    """Return whether a model has more than noise more gap in all of a recording than the nominal model, [M, S] each."""
    before, after = ((np.nan_to_num(gap) ** 2).sum(axis=1) for gap in (nominal, left))
    recording, noise = np.array(origins)[view.trial], float(np.sum(view.floor**2))
    return bool((np.bincount(recording, after - before - noise) > 0).any())
