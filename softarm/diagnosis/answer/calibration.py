"""Calibration of a nominal model in a verdict: each resolved parameter, and the gap that is left with all of them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.calibration import Calibration, calibrate, held_out_rms
from softarm.diagnosis.engine.fits import Fit, FitProblem
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.view import Array
from softarm.schemas.verdict import CalibratedParameter

# Share of its stage's gap, held out, that a calibrated parameter takes at least: a smaller one is not worth a change.
WORTH = 0.01
AT_EDGE = 0.98  # share of the box's edge from which a parameter counts as at its edge


@dataclass(frozen=True, slots=True)
class Calibrated:
    """Calibration next to the named effects."""

    parameters: tuple[CalibratedParameter, ...] = ()  # what takes most of the gap first
    rms: Mapping[str, float] = field(default_factory=dict)  # stage -> RMS gap with effects and calibration, held out
    # Stage -> residual with effects and calibration, [M, S]; empty if no parameter is resolved.
    residuals: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)
    values: Mapping[str, float] = field(default_factory=dict)  # path -> fitted value; of a single joint its change
    folds: tuple[Mapping[str, float], ...] = ()  # the same fitted without each fold


def calibrated(
    setup: Setup, problem: FitProblem, plain: FitProblem, fit: Fit, unit: Callable[[str], str]
) -> Calibrated:
    """Return the calibration next to a fit's effects.

    Args:
        setup: problem of the views.
        problem: the same, whitened, with the folds of the verdict.
        plain: the same in units of the noise floors.
        fit: named effects and their parameters.
        unit: returns the unit of a parameter by its path.
    """
    found = calibrate(problem, fit)
    left, takes = _takes(setup, plain, fit, found)
    # The others are fitted again without a parameter, and may then take less themselves.
    while len(worth := [i for i, share in takes.items() if share >= WORTH]) < len(takes):
        found = calibrate(problem, fit, worth)
        left, takes = _takes(setup, plain, fit, found)
    scales = setup.nuisance_scales()
    parameters = []
    for i in found.resolved:
        path, nominal, scale = scales[i]
        share, half = float(found.shares[i]), float(found.half[i])
        ends = sorted(nominal + float(edge[i]) * scale for edge in (problem.nuisance_low, problem.nuisance_high))
        parameters.append(
            CalibratedParameter(
                name=path,
                nominal=nominal,
                value=nominal + share * scale,
                low=nominal + share * scale - half * abs(scale),
                high=nominal + share * scale + half * abs(scale),
                unit=unit(path),
                tolerance_low=ends[0],
                tolerance_high=ends[1],
                at_edge=bool(abs(share) >= AT_EDGE),
                shrink=takes[i],
            )
        )
    values, *folds = (_values(scales, found.resolved, shares) for shares in (found.shares, *found.folds))
    ordered = sorted(parameters, key=lambda each: (-each.shrink, each.name))
    residuals: dict[str, NDArray[np.float32]] = {}
    if parameters:
        each_view = setup.residuals(plain, replace(fit, nuisance=found.shares))
        residuals = {view.stage: each for view, each in zip(setup.views, each_view, strict=True)}
    return Calibrated(tuple(ordered), left, residuals, values, tuple(folds))


def _takes(
    setup: Setup, plain: FitProblem, fit: Fit, found: Calibration
) -> tuple[Mapping[str, float], dict[int, float]]:
    """Return each stage's held-out RMS, and the share of it that each resolved parameter takes next to the others."""
    left, takes = held_out_rms(setup, plain, fit, found.folds), {}
    for i in found.resolved:
        less = held_out_rms(setup, plain, fit, found.without[i])
        takes[i] = max(1 - left[stage] / less[stage] if less[stage] > 0 else 0.0 for stage in left)
    return left, takes


def _values(scales: list[tuple[str, float, float]], resolved: tuple[int, ...], shares: Array) -> dict[str, float]:
    return {scales[i][0]: scales[i][1] + float(shares[i]) * scales[i][2] for i in resolved}
