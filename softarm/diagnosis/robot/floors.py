"""Noise floors on the trials at hand: the views' floors plus the effect of tolerated deviations.

Tolerated deviations, such as a joint that is 4 % off or a gain of 1 %, add up at the tip to more than a fixed floor.
The fit estimates their effect, and the floor that a verdict shows includes it.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.answer.evidence import rms
from softarm.diagnosis.engine.fits import Fit, FitProblem
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.structure import Structure
from softarm.diagnosis.engine.thresholds import ROBOT
from softarm.diagnosis.engine.view import Array, Point, View
from softarm.diagnosis.engine.whitened import samples, slices
from softarm.diagnosis.robot.chain import FLOOR_M, tip_gap
from softarm.diagnosis.robot.trial_grid import TrialGrid
from softarm.diagnosis.robot.views import with_joints
from softarm.schemas.model import Model

# Floor of the cart's velocity averaged over one second: 6 mm/s are a third of the velocity's floor, but 10 cm in 20 s.
# Nominal robots of the independent simulator show 2.3 to 3.1 mm/s.
DRIFT_FLOOR_M_S, DRIFT_S = 0.0045, 1.0


def stage_floors(setup: Setup, plain: FitProblem, fit: Fit) -> dict[str, float]:
    """Return each stage's noise floor, RMS: floor, noise, and the effect of the fit's nuisances and starts."""
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
