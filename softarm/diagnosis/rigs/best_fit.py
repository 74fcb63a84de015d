"""Best fit of a stage: the effects that predict its whole recordings best, named or not; a model, no diagnosis."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import cast

import numpy as np

from softarm.diagnosis.answer.calibration import Calibrated, calibrated
from softarm.diagnosis.answer.evidence import rms
from softarm.diagnosis.engine.fits import Fit, FitProblem
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.candidates import setup_of
from softarm.diagnosis.rigs.views import RigView
from softarm.schemas.verdict import BestFit, Quantity

# Rounds of a fit to whole recordings, which begins at one to their windows.
ROUNDS = 6

# Returns the unit of a parameter by its path.
Unit = Callable[[str], str]


def stage_calibration(setup: Setup, problem: FitProblem, plain: FitProblem, fit: Fit, unit: Unit) -> Calibrated:
    """Return the calibration next to the effects of a fit; a held effect keeps the size that all stages found.

    Args:
        setup: problem of one view.
        problem: the same with weights.
        plain: the same in units of the noise floors.
        fit: effects.
        unit: returns the unit of a parameter by its path.
    """
    (view,) = cast("tuple[RigView]", setup.views)
    free = np.array([path not in view.held for path in problem.nuisance_paths])
    problem = replace(problem, nuisance_low=problem.nuisance_low * free, nuisance_high=problem.nuisance_high * free)
    return calibrated(setup, problem, plain, fit, unit)


def best_fit(setup: Setup, named: Fit, best: Fit, unit: Unit) -> BestFit | None:
    """Return effects fitted to whole recordings, or None if the named ones predict these as well.

    Windows of a recording begin at its measured motion, and so hide slow errors that a simulation adds up.

    Args:
        setup: problem of the stage.
        named: fit of the named effects.
        best: fit of the effects that predict the windows best.
        unit: returns the unit of a parameter by its path.
    """
    (view,) = cast("tuple[RigView]", setup.views)
    if not best.effects:
        return None
    runs = view.uninterrupted()
    whole = setup_of(runs, setup.kinds, setup.origins)
    problem = whole.plain()
    (fit,) = problem.fit([(best.effects, best.u)], ROUNDS)
    tuned, usual = (stage_calibration(whole, problem, problem, each, unit) for each in (fit, named))
    shares = any(name.rpartition(".")[2] in view.shared for name in named.names)
    if tuned.rms[view.stage] >= usual.rms[view.stage] and not shares:
        return None
    held = {path: view.nominal(path.partition(".")[2]) for path in view.original}
    values = {path: x for path, x in {**held, **tuned.values, **fit.point}.items() if math.isfinite(x)}
    nominal, left = runs.gap([view.original, values]).astype(float)
    if _worsens(runs, nominal, left, setup.origins):
        return None
    return BestFit(
        parameters={path: Quantity(value=x, unit=unit(path)) for path, x in values.items()},
        before=Quantity(value=rms(nominal), unit=view.unit),
        after=Quantity(value=tuned.rms[view.stage], unit=view.unit),
    )


def _worsens(view: RigView, nominal: Array, left: Array, origins: Sequence[int]) -> bool:
    """Return whether a model has more than noise more gap in all of a recording than the nominal model, [M, S] each."""
    before, after = ((np.nan_to_num(gap) ** 2).sum(axis=1) for gap in (nominal, left))
    recording, noise = np.array(origins)[view.trial], float(np.sum(view.floor**2))
    return bool((np.bincount(recording, after - before - noise) > 0).any())
