"""Comparison of the robot's trials with a nominal model: gaps, their noise floors, and their shrink by effects."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.answer.assembly import share
from softarm.diagnosis.answer.evidence import rms
from softarm.diagnosis.data.trials import Trial, TrialError
from softarm.diagnosis.engine.fits import Fit, FitProblem
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.search import SelectedEffect
from softarm.diagnosis.engine.shrink import chain_interval, interval
from softarm.diagnosis.engine.structure import Structure
from softarm.diagnosis.engine.thresholds import ROBOT
from softarm.diagnosis.engine.view import Array, Point, View
from softarm.diagnosis.engine.whitened import Cache, Gaps, WhitenedResidual, samples, slices
from softarm.diagnosis.engine.work import Progress
from softarm.diagnosis.robot.candidates import nuisances
from softarm.diagnosis.robot.chain import FLOOR_M, tip_gap
from softarm.diagnosis.robot.drive import with_identified_drive
from softarm.diagnosis.robot.trial_grid import TrialGrid, on_grid
from softarm.diagnosis.robot.views import RobotView, robot_views, with_joints
from softarm.schemas.model import Model
from softarm.schemas.verdict import Interval, Shrink

Gap = NDArray[np.float32]

# Floor of the cart's velocity averaged over one second: 6 mm/s are a third of the velocity's floor, but 10 cm in 20 s.
# Nominal robots of the independent simulator show 2.3 to 3.1 mm/s.
DRIFT_FLOOR_M_S, DRIFT_S = 0.0045, 1.0
# Energy from which an effect is judged in its own stage.
OWN_STAGE_MIN = 0.1


@dataclass(frozen=True, slots=True)
class Comparison:
    """Trials of the robot next to a nominal model."""

    trials: tuple[Trial, ...]
    nominal: Model
    model: Model  # the nominal model, with the drive that the trials show
    grid: TrialGrid
    views: tuple[RobotView, ...]
    setup: Setup
    tips: Cache[Gap]

    @property
    def stages(self) -> tuple[str, ...]:
        """Return the stages that the trials show."""
        return tuple(view.stage for view in self.views)

    def held_out(self, gaps: NDArray[np.floating]) -> Gap:
        """Return each sample's gap [M, S] from gaps by fold [F, M, S]: the one whose fit did not use the sample."""
        own = self.setup.by_sample(self.views[0], np.unique(self.setup.fold, return_inverse=True)[1])
        return np.asarray(gaps[own, np.arange(len(own))])

    def tip_gaps(self, points: Sequence[Point]) -> Gap:
        """Return measured minus simulated tip (y, z), from commands alone, at each point, m, [P, M, 2]."""
        return np.stack(self.tips.fetch([tuple(sorted(point.items())) for point in points]))

    def squares(self, gap: NDArray[np.floating]) -> Array:
        """Return the squares of a gap [M, S] by trial, [K], or by block if there is only one trial."""
        part, count = self.grid.sample[1], len(self.trials)
        if count < 2:
            count = len(self.setup.blocks)
            part = self.setup.by_sample(self.views[0], np.arange(count))
        return np.array([np.nansum(gap[part == k].astype(float) ** 2) for k in range(count)])


def compare(trials: Sequence[Trial], nominal: Model, progress: Progress) -> Comparison:
    """Prepare the comparison of trials with a nominal model; raise TrialError if no stage can be compared."""
    progress("resampling the trials", 0.02)
    grid = on_grid(trials, nominal)
    kinds = [trial.kind for trial in trials]
    model = with_identified_drive(grid, nominal, kinds)
    views = robot_views(grid, model)
    if not views:
        raise TrialError(f"{trials[0].source}: no stage can be compared; record pressure, rail or mocap as well")
    progress("simulating each stage alone", 0.08)
    setup = Setup(views, nuisances(model), kinds)
    if len(setup.blocks) < 2:
        raise TrialError(
            f"{trials[0].source}: is one trial of 2 s, which leaves no held-out part; longer than that is needed; "
            "record longer, or add a second trial"
        )
    tips = Cache(lambda keys: tip_gap(grid, model, [dict(key) for key in keys]))
    return Comparison(tuple(trials), nominal, model, grid, views, setup, tips)


def stage_floors(setup: Setup, plain: FitProblem, fit: Fit) -> dict[str, float]:
    """Return each stage's noise floor, RMS: floor, noise, and the effect of the fit's nuisances and starts.

    Tolerated deviations, such as a joint that is 4 % off, add up at the tip to more than a fixed floor.
    """
    found = {}
    for view, gaps, left in zip(setup.views, setup.gaps, setup.residuals(plain, fit), strict=True):
        taken = max(rms(gaps.fetch([fit.point])[gaps.key(fit.point)]) ** 2 - rms(left) ** 2, 0.0)
        found[view.stage] = float(np.sqrt(np.mean(view.floor**2 + view.noise**2) + taken))
    return found


def chain_floor(grid: TrialGrid, model: Model, setup: Setup, fit: Fit, gap: NDArray[np.floating]) -> float:
    """Return the noise floor of the tip, RMS, m; gap: the tip's gap at the fit's point, [M, 2]."""
    nuisances = setup.fitted_nuisances(fit)
    left = tip_gap_with(grid, model, nuisances, fit.point)
    taken = max(2 * rms(gap) ** 2 - 2 * rms(left) ** 2, 0.0)
    return float(np.sqrt(FLOOR_M**2 + taken))


def tip_gap_with(grid: TrialGrid, model: Model, nuisances: Mapping[str, float], point: Point) -> NDArray[np.floating]:
    """Return the tip's gap [M, 2], m, of a model with fitted nuisances and, over them, the effects of a point."""
    plain = {path: x for path, x in nuisances.items() if "[" not in path}
    gap: NDArray[np.floating] = tip_gap(grid, with_joints(model, nuisances), [plain | dict(point)])[0]
    return gap


def drift(view: View, before: NDArray[np.floating], after: NDArray[np.floating]) -> Structure | None:
    """Return the slow part of the rail's velocity residual, or None if it is within its floor.

    The residuals are without and with the chosen effects, m/s, [M, 1].
    """
    first, last = (slow(view, residual) / DRIFT_FLOOR_M_S for residual in (before, after))
    if last**2 <= max(1.0, ROBOT.gap.structure_share * (first**2 - last**2)):
        return None
    return Structure(
        last**2, f"velocity error of {1e3 * last * DRIFT_FLOOR_M_S:.1f} mm/s averaged over one second (drift)"
    )


def slow(view: View, residual: NDArray[np.floating]) -> float:
    """Return the RMS of a residual's first channel averaged over DRIFT_S, within trials that measured it."""
    length = samples(view, DRIFT_S)
    found: list[Array] = []
    for part in slices(view.trial):
        values = np.asarray(residual[part, 0], dtype=float)
        seen = np.isfinite(values).astype(float)
        if seen.sum() >= length:
            sums, counts = (np.convolve(x, np.ones(length), "valid") for x in (np.nan_to_num(values), seen))
            found.append(sums[counts > length / 2] / counts[counts > length / 2])
    together = np.concatenate(found) if found else np.zeros(1)
    return float(np.sqrt(np.mean(together**2)))


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
