"""Calibration: parameters that the nominal model has, fitted within their boxes next to the chosen effects.

A box says how far a parameter of a good model may be off. A parameter that the data do not resolve stays nominal, so
that a calibrated model differs from the nominal one only where the data show a difference.
"""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine import box
from softarm.diagnosis.engine.fits import Fit, FitProblem
from softarm.diagnosis.engine.jackknife import covariance, ridge
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.view import Array

Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Calibration:
    """Fitted nuisances as shares of their boxes' edges; 0 is nominal."""

    shares: Array  # [q] 0 for a parameter that stays nominal
    half: Array  # [q] half the 95 % interval, without the box; 0 for a parameter that stays nominal
    folds: Array  # [F, q] fitted without each fold
    without: dict[int, Array]  # resolved parameter -> the others fitted without each fold, [F, q]

    @property
    def resolved(self) -> tuple[int, ...]:
        """Return the parameters whose interval excludes the nominal value."""
        return tuple(self.without)


class _Linear:
    """Linearisation of a fit: effects first, then the nuisances; the effects stay at the fit's values."""

    def __init__(self, problem: FitProblem, fit: Fit) -> None:
        self.normal, self.slope, self.low, self.high = problem.linear(fit)
        self.fold, self.effects = problem.fold, np.arange(len(fit.x))
        self.moved = fit.folds - fit.x if fit.effects else np.zeros((len(np.unique(self.fold)), 0))  # [F, p]

    def solve(self, free: Indices, kept: NDArray[np.bool_], moved: Array) -> Array:
        """Return the nuisances [q] that fit the kept blocks best next to moved effects, 0 where they are not free."""
        normal, slope = self.normal[kept].sum(axis=0), self.slope[kept].sum(axis=0)
        slope = slope + normal[:, self.effects] @ moved
        solution = np.zeros(len(slope))
        matrix = np.ascontiguousarray(normal[np.ix_(free, free)])
        solution[free] = box.solve(matrix, -slope[free], self.low[free], self.high[free])
        return solution[len(self.effects) :]

    def by_fold(self, free: Indices) -> Array:
        """Return the nuisances fitted without each fold, [F, q]."""
        folds = zip(np.unique(self.fold), self.moved, strict=True)
        return np.array([self.solve(free, self.fold != fold, moved) for fold, moved in folds])

    def half_widths(self, free: Indices) -> Array:
        """Return half the 95 % interval of each free nuisance without its box, next to uncertain effects."""
        both = np.concatenate((self.effects, free))
        normal, slope = self.normal[:, both][:, :, both], self.slope[:, both]
        total = normal.sum(axis=0)
        total[range(len(both)), range(len(both))] += ridge(total)
        spread = covariance(normal, slope, np.linalg.solve(total, -slope.sum(axis=0)))
        return np.asarray(np.sqrt(spread.diagonal()[len(self.effects) :]))


def calibrate(problem: FitProblem, fit: Fit, among: Collection[int] | None = None) -> Calibration:
    """Return the calibration next to a fit's effects; `among`: nuisances that may leave their nominal value."""
    linear = _Linear(problem, fit)
    first = len(linear.effects)
    if among is not None:
        others = [first + i for i in range(len(problem.nuisance_low)) if i not in among]
        linear.low[others] = linear.high[others] = 0.0
    free, shares, half = _resolved(linear)
    halves = np.zeros(len(shares))
    halves[free - first] = half
    without = {int(i) - first: linear.by_fold(free[free != i]) for i in free}
    return Calibration(shares, halves, linear.by_fold(free), without)


def _resolved(linear: _Linear) -> tuple[Indices, Array, Array]:
    """Return the free unknowns, all nuisances [q], and half the interval of each free one.

    The nuisance that is resolved least is set to nominal and the others are fitted again, until all are resolved.
    """
    first = len(linear.effects)
    everything, still = np.ones(len(linear.fold), dtype=bool), np.zeros(first)
    free = first + np.flatnonzero(linear.high[first:] > linear.low[first:])
    while len(free):
        shares, half = linear.solve(free, everything, still), linear.half_widths(free)
        certainty = np.abs(shares[free - first]) / np.maximum(half, 1e-30)
        if certainty.min() >= 1:
            return free, shares, half
        free = np.delete(free, int(certainty.argmin()))
    return free, np.zeros(len(linear.low) - first), np.zeros(0)


def held_out_rms(setup: Setup, plain: FitProblem, fit: Fit, folds: Array) -> dict[str, float]:
    """Return each stage's RMS gap with a fit's effects and with nuisances, each block without its own fold.

    Args:
        setup: problem of the views.
        plain: the same in units of the noise floors.
        fit: effects and their parameters by fold.
        folds: nuisances fitted without each fold, in units of the boxes' edges, [F, q].
    """
    squares = held_out_squares(setup, plain, fit, folds)
    samples = {view.stage: int(np.isfinite(view.measured).sum()) for view in setup.views}
    return {stage: float(np.sqrt(each.sum() / max(samples[stage], 1))) for stage, each in squares.items()}


def held_out_squares(setup: Setup, plain: FitProblem, fit: Fit, folds: Array) -> dict[str, Array]:
    """Return the squares of each stage's gap by block, [B], in its squared unit; arguments as for `held_out_rms`."""
    numbers = np.unique(plain.fold, return_inverse=True)[1]
    fold_of = dict(zip(plain.blocks, numbers, strict=True))
    place = {name: i for i, name in enumerate(plain.blocks)}
    points = fit.fold_points if fit.effects else [{}] * len(folds)
    found = {}
    for view, residual in zip(setup.views, plain.whitened, strict=True):
        moments = residual.moments(points)
        squares = np.zeros(len(place))
        for name, part in residual.blocks:
            fold = fold_of[name]
            rows = moments[fold].rows[part] + folds[fold].astype(np.float32) @ residual.columns[:, part]
            left = rows.reshape(-1, len(view.floor)) * view.floor
            squares[place[name]] += float((left**2).sum())
        found[view.stage] = squares
    return found
