"""What nobody is blamed for on these very recordings: the views' floors, and what tolerated deviations make of them.

A joint 4 % off, a gain of 1 % are within what well-kept robots are off by, and at the tip they add up to more than any
fixed floor. How much that is here the fit knows: the floor that a verdict shows holds it.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.fits import Fit, FitProblem
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.structure import Structure
from softarm.diagnosis.engine.view import Array, View
from softarm.diagnosis.engine.whitened import slices
from softarm.diagnosis.robot.chain import FLOOR_M, tip_gap
from softarm.diagnosis.robot.trial_grid import TrialGrid
from softarm.diagnosis.robot.views import JOINT_SHARES
from softarm.schemas.model import Model

# Of the cart's velocity averaged over a second. It drifts away unseen: 6 mm/s are a third of the velocity's floor, and
# 10 cm in 20 s. Nominal robots of the independent simulator show 2.3 to 3.1 mm/s.
DRIFT_FLOOR_M_S, DRIFT_S = 0.0045, 1.0


def stage_floors(setup: Setup, plain: FitProblem, fit: Fit) -> dict[str, float]:
    """Stage -> RMS that counts as none beside a fit: floor, noise, and what its nuisances and starts take away."""
    found = {}
    for view, gaps, left in zip(setup.views, setup.gaps, setup.residuals(plain, fit), strict=True):
        taken = max(rms(gaps.fetch([fit.point])[gaps.key(fit.point)]) ** 2 - rms(left) ** 2, 0.0)
        found[view.stage] = float(np.sqrt(np.mean(view.floor**2 + view.noise**2) + taken))
    return found


def chain_floor(grid: TrialGrid, model: Model, setup: Setup, fit: Fit, gap: NDArray[np.floating]) -> float:
    """The same of the tip, m; its gap [M, 2] at the fit's point, the nuisances as written."""
    nuisances = setup.fitted_nuisances(fit)
    kept, point = with_joints(model, nuisances), {k: x for k, x in nuisances.items() if "[" not in k} | {**fit.point}
    left = tip_gap(grid, kept, [point])[0]
    taken = max(2 * rms(gap) ** 2 - 2 * rms(left) ** 2, 0.0)
    return float(np.sqrt(FLOOR_M**2 + taken))


def with_joints(model: Model, nuisances: Mapping[str, float]) -> Model:
    """A model whose single joints are off by the shares of the fitted nuisances, `arm.NAME[JOINT]`."""
    changed: dict[str, tuple[float, ...]] = {}
    for name in JOINT_SHARES:
        values = getattr(model.arm, name)
        largest = max(map(abs, values))
        shares = [nuisances.get(f"arm.{name}[{i}]", 0.0) for i in range(1, len(values) + 1)]
        of = [largest if name == "torque_offset_nm" else value for value in values]
        changed[name] = tuple(value + share * size for value, share, size in zip(values, shares, of, strict=True))
    return model.model_copy(update={"arm": model.arm.model_copy(update=changed)})


def drift(view: View, before: NDArray[np.floating], after: NDArray[np.floating], share: float) -> Structure | None:
    """A residual that stays off to one side for a second and more: of the rail, whose position is its sum.

    before, after: [M, 1] without and with the chosen effects. None within the floor, or a `share` of what they took.
    """
    first, last = (slow(view, residual) / DRIFT_FLOOR_M_S for residual in (before, after))
    if last**2 <= max(1.0, share * (first**2 - last**2)):
        return None
    return Structure(last**2, f"{1e3 * last * DRIFT_FLOOR_M_S:.1f} mm/s, averaged over a second: it drifts", 1, 1)


def slow(view: View, residual: NDArray[np.floating]) -> float:
    """RMS of a residual's first channel averaged over DRIFT_S, within the trials in which it was measured."""
    length = max(1, round(DRIFT_S / float(np.median(np.diff(view.t_s[slices(view.trial)[0]])))))
    found: list[Array] = []
    for part in slices(view.trial):
        values = np.asarray(residual[part, 0], dtype=float)
        seen = np.isfinite(values).astype(float)
        if seen.sum() >= length:
            sums, counts = (np.convolve(x, np.ones(length), "valid") for x in (np.nan_to_num(values), seen))
            found.append(sums[counts > length / 2] / counts[counts > length / 2])
    together = np.concatenate(found) if found else np.zeros(1)
    return float(np.sqrt(np.mean(together**2)))


def rms(values: NDArray[np.floating]) -> float:
    """Of what was measured."""
    return float(np.sqrt(np.nanmean(np.asarray(values, dtype=float) ** 2)))
