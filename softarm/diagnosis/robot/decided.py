"""Decision on the robot's gaps, with the noise floors that hold on these trials."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from softarm.diagnosis.answer.calibration import Calibrated, calibrated
from softarm.diagnosis.answer.evidence import rms
from softarm.diagnosis.engine.decision import Decision
from softarm.diagnosis.engine.examination import Examination
from softarm.diagnosis.engine.fits import Fit
from softarm.diagnosis.engine.structure import Structure
from softarm.diagnosis.robot.calibration import unit_of
from softarm.diagnosis.robot.chain import stage_of_tip_gap
from softarm.diagnosis.robot.comparison import Comparison
from softarm.diagnosis.robot.floors import chain_floor, drift, stage_floors
from softarm.diagnosis.robot.markers import loose_marker


@dataclass(frozen=True, slots=True)
class Decided:
    """Decision on the robot's gaps."""

    decision: Decision
    floors: Mapping[str, float]  # stage -> noise floor, RMS
    chain_floor: float | None  # noise floor of the tip, RMS, m; None if mocap has no tip
    fit: Fit  # of the named effects alone
    calibrated: Calibrated  # next to the named effects


def decide(comparison: Comparison, found: Examination) -> Decided:
    """Return the decision; it is `none` only if every stage and the tip are within their noise floors."""
    signs = _signs(comparison, found)
    decision = found.decide(signs)
    named = found.named(decision)
    floors = stage_floors(comparison.setup, found.plain, named)
    tip_floor = None
    tip = comparison.tip_gaps([named.point])[0]
    if np.isfinite(tip).any():
        tip_floor = chain_floor(comparison.grid, comparison.model, comparison.setup, named, tip)
    if decision.kind == "none":
        decision = found.decide(signs | _above_floors(comparison, floors, tip_floor))
    calibration = calibrated(comparison.setup, found.verdict_problem, found.plain, named, unit_of)
    return Decided(decision, floors, tip_floor, named, calibration)


def _signs(comparison: Comparison, found: Examination) -> dict[str, Structure]:
    """Return a drift of the cart and a loose marker, by stage."""
    signs: dict[str, Structure] = {}
    if "rail" in comparison.stages:
        view = comparison.views[comparison.stages.index("rail")]
        drifting = drift(view, found.null_residuals["rail"], found.residuals["rail"])
        signs |= {"rail": drifting} if drifting else {}
    loose = loose_marker(comparison.trials, comparison.grid.links)
    return signs | ({"mocap": loose} if loose else {})


def _above_floors(comparison: Comparison, floors: Mapping[str, float], tip_floor: float | None) -> dict[str, Structure]:
    """Return the stages above their noise floors, or the stage in which a tip gap above its floor arises."""
    found: dict[str, Structure] = {}
    for view, gaps in zip(comparison.views, comparison.setup.gaps, strict=True):
        ratio = rms(gaps.fetch([{}])[()]) / floors[view.stage]
        if ratio > 1:
            found[view.stage] = Structure(ratio**2, f"gap of {ratio:.2g} times its noise floor")
    if not found and tip_floor is not None:
        ratio = np.sqrt(2) * rms(comparison.tip_gaps([{}])[0]) / tip_floor
        if ratio > 1:
            stage = stage_of_tip_gap(comparison.grid, comparison.model)
            found[stage] = Structure(ratio**2, f"tip gap of {ratio:.2g} times its noise floor")
    return found
