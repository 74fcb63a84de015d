"""Shrink of the robot's gaps by named effects, held out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from softarm.diagnosis.answer.assembly import share
from softarm.diagnosis.answer.evidence import rms
from softarm.diagnosis.engine.fits import Fit, FitProblem
from softarm.diagnosis.engine.search import SelectedEffect
from softarm.diagnosis.engine.shrink import chain_interval, interval
from softarm.diagnosis.engine.view import Array, Point, View
from softarm.diagnosis.engine.whitened import Gaps, WhitenedResidual
from softarm.diagnosis.robot.comparison import Comparison
from softarm.schemas.verdict import Interval, Shrink

OWN_STAGE_MIN = 0.1  # energy from which an effect is judged in its own stage


@dataclass(frozen=True, slots=True)
class HeldOutGap:
    """RMS of a gap without and with all named effects, held out, and the share that they remove."""

    before: float
    after: float
    total_shrink: Interval


def stage_gap(comparison: Comparison, view: View, gaps: Gaps, points: Sequence[Point]) -> HeldOutGap:
    """Return a stage's gap; points: the named effects' parameters, fitted without each fold."""
    found = gaps.fetch([{}, *points])
    patched = comparison.held_out(np.stack([found[gaps.key(point)] for point in points]))
    squares = (comparison.squares(gap) for gap in (found[()], patched))
    return HeldOutGap(rms(found[()]), rms(patched), share(*interval(*squares)))


def held_out_tip_gap(comparison: Comparison, points: Sequence[Point]) -> HeldOutGap | None:
    """Return the tip's gap from commands alone, m, or None if mocap has no tip; points as for a stage."""
    tips = comparison.tip_gaps([{}, *points])
    if not np.isfinite(tips).any():
        return None
    patched = comparison.held_out(tips[1:])
    before, after = (float(np.sqrt(2) * rms(gap)) for gap in (tips[0], patched))
    squares = (comparison.squares(gap) for gap in (tips[0], patched))
    return HeldOutGap(before, after, share(*chain_interval(*squares)))


def effect_shrink(
    comparison: Comparison, plain: FitProblem, effect: SelectedEffect, without: Fit, named: Fit
) -> Shrink:
    """Return the shares of its stage's and of the tip's gap that an effect removes next to the other named effects.

    Every trial is judged by parameters that were fitted without its kind of excitation. without: fit of the other named
    effects; named: fit of all.
    """
    own = {d.path for d in effect.candidate.parameters} | set(effect.candidate.form)
    residual = plain.whitened[comparison.stages.index(_stage_of(effect))]
    fits = (without.fold_points, named.fold_points)
    stage = interval(*(_squares(plain, residual, each, len(comparison.trials)) for each in fits))
    less = [{k: v for k, v in each.items() if k not in own} for each in named.fold_points]
    tips = [comparison.held_out(gaps) for gaps in np.split(comparison.tip_gaps([*less, *named.fold_points]), 2)]
    chain = None
    if np.isfinite(tips).any():
        chain = share(*chain_interval(*map(comparison.squares, tips)))
    return Shrink(stage=share(*stage), chain=chain)


def _stage_of(effect: SelectedEffect) -> str:
    """Return the stage in which an effect is judged: its own if it shows there, else where it shows most."""
    energies, own = effect.gain.energies, effect.candidate.stage
    return own if energies.get(own, 0.0) > OWN_STAGE_MIN else effect.strongest


def _squares(plain: FitProblem, residual: WhitenedResidual, fold_points: Sequence[Point], trials: int) -> Array:
    """Return the squares of a stage's residual in noise floors, by trial [K], or by block if there is only one trial.

    Each trial, or block, is judged at its own fold's point.
    """
    moments = residual.moments(list(fold_points))
    folds, rows_of = list(np.unique(plain.fold)), dict(residual.blocks)
    squares = np.zeros(len(plain.blocks) if trials < 2 else trials)
    for i, (name, fold) in enumerate(zip(plain.blocks, plain.fold, strict=True)):
        if name in rows_of:
            rows = moments[folds.index(fold)].rows[rows_of[name]]
            squares[i if trials < 2 else name[0]] += float(rows @ rows)
    return squares
