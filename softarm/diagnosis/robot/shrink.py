"""Shrink of the robot's gaps: from a nominal to a patched model on given trials, and of named effects, held out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from softarm.diagnosis.answer.assembly import share
from softarm.diagnosis.answer.evidence import rms
from softarm.diagnosis.data.trials import Trial
from softarm.diagnosis.engine.fits import Fit, FitProblem
from softarm.diagnosis.engine.search import SelectedEffect
from softarm.diagnosis.engine.shrink import chain_interval, interval
from softarm.diagnosis.engine.view import Array, Point, View
from softarm.diagnosis.engine.whitened import Gaps, WhitenedResidual
from softarm.diagnosis.robot.chain import tip_gap
from softarm.diagnosis.robot.comparison import Comparison
from softarm.diagnosis.robot.counts import counts
from softarm.diagnosis.robot.drive import SERVO, with_servo
from softarm.diagnosis.robot.trial_grid import TrialGrid, on_grid
from softarm.diagnosis.robot.views import ON_MOTOR, robot_views
from softarm.schemas.model import Model
from softarm.schemas.verdict import Interval, Shrink
from softarm.simulator.effects import REGISTRY, value

OWN_STAGE_MIN = 0.1  # energy from which an effect is judged in its own stage


def measure_shrink(trials: Sequence[Trial], nominal: Model, patched: Model) -> dict[str, float]:
    """Return 1 - RMS gap of `patched` over that of `nominal`, by stage and for the tip (`chain`).

    Nothing is fitted. Stages that the trials do not show are left out. A servo of the patched model also drives the
    nominal one, as in the verdict, so that no effect is credited with it.
    """
    nominal = with_servo(nominal) if SERVO in patched.effects else nominal
    shown = on_grid(trials, nominal)
    difference = point_between(nominal, patched)
    # A model file does not state the place of the axis's encoder: the reading that fits better counts.
    readings = [difference, {**difference, ON_MOTOR: 1.0}]
    best = min((_shrinks(shown, nominal, each) for each in readings), key=lambda f: -sum(f.values()))
    found = dict(best)
    if found.get("rail") == 0.0 and "mocap" in found and any(path.startswith("rail.") for path in difference):
        found["rail"] = found["mocap"]  # an encoder on the motor shows neither play nor a wrong feed, but mocap does
    for one, other in zip(counts(trials, nominal), counts(trials, patched), strict=True):
        if one.before > one.floor and other.nominal != one.nominal:
            found[one.stage] = 1 - other.before / one.before
    tips = tip_gap(shown, nominal, [{}, difference])
    if np.isfinite(tips).any():
        before, after = map(rms, tips)
        found["chain"] = 1 - after / before if before > 0 else 0.0
    return found


def _shrinks(shown: TrialGrid, nominal: Model, point: Point) -> dict[str, float]:
    found = {}
    for view in robot_views(shown, nominal):
        before, after = view.gap([{}, point])
        first, last = rms(before / view.floor), rms(after / view.floor)
        found[view.stage] = 1 - last / first if first > 0 else 0.0
    return found


def point_between(nominal: Model, patched: Model) -> Point:
    """Return the parameters in which the second model's effects differ from the first's."""
    return {
        f"{name}.{p.name}": value(patched, name, p.name)
        for name, effect in REGISTRY.items()
        for p in effect.parameters
        if value(patched, name, p.name) != value(nominal, name, p.name)
    }


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
