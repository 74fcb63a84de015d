"""Decision on the robot's gaps, with the calibration next to the named effects and the regime of the largest gap."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from softarm.common.quantity import PURE
from softarm.diagnosis.answer.calibration import Calibrated, calibrated
from softarm.diagnosis.answer.evidence import Gap, density, regimes, rms
from softarm.diagnosis.engine.decision import Decision
from softarm.diagnosis.engine.examination import Examination
from softarm.diagnosis.engine.fits import Fit
from softarm.diagnosis.engine.structure import Structure
from softarm.diagnosis.engine.view import Point, View
from softarm.diagnosis.robot.chain import stage_of_tip_gap
from softarm.diagnosis.robot.comparison import Comparison, chain_floor, drift, stage_floors, tip_gap_with
from softarm.diagnosis.robot.markers import loose_marker
from softarm.diagnosis.robot.trial_grid import RATE_HZ
from softarm.diagnosis.robot.views import with_joints
from softarm.schemas.model import Model
from softarm.simulator.effects import REGISTRY, find, value

BANDS = ((0.0, 0.5, "below 0.5 Hz"), (0.5, 2.0, "from 0.5 to 2 Hz"), (2.0, 30.0, "above 2 Hz"))
# Shorter regimes are left out; one with this many times the overall RMS is named.
REGIME_S, REGIME_CLEAR = 2.0, 1.2


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


def calibrated_tip(comparison: Comparison, found: Calibrated, points: Sequence[Point]) -> float:
    """Return the tip's RMS gap with named effects and calibration, m, held out; points: the effects by fold."""
    by_fold = [
        tip_gap_with(comparison.grid, comparison.model, values, point)
        for values, point in zip(found.folds, points, strict=True)
    ]
    return float(np.sqrt(2) * rms(comparison.held_out(np.stack(by_fold))))


def with_calibration(model: Model, values: Mapping[str, float]) -> Model:
    """Return the model with calibrated parameters; an effect that it has already keeps its other parameters."""
    effects = {name: dict(given) for name, given in model.effects.items()}
    for path, found in values.items():
        name, _, parameter = path.rpartition(".")
        if name in REGISTRY:
            given = effects.setdefault(name, {p.name: value(model, name, p.name) for p in REGISTRY[name].parameters})
            given[parameter] = found
    return with_joints(model.model_copy(update={"effects": effects}), values)


def unit_of(path: str) -> str:
    """Return the unit of a parameter; a single joint's change is a share."""
    return PURE if "[" in path else find(path)[1].unit


def largest_regime(view: View, gap: Gap) -> str:
    """Return the regime and the frequency band with the largest gap; no band if every trial is too short for one."""
    overall = rms(gap)
    frequency, amplitude = density(view, gap, RATE_HZ)
    powers = [float((amplitude[(frequency >= a) & (frequency < b)] ** 2).sum()) for a, b, _ in BANDS]
    band = BANDS[int(np.argmax(powers))][2] if sum(powers) > 0 else ""
    found = regimes(view, gap, None, REGIME_S) if overall else ()
    largest = max(((each.nominal_rms / overall, each.name) for each in found), default=(0.0, ""))
    regime = largest[1] if largest[0] > REGIME_CLEAR else "throughout"
    return f"{regime}, {band}" if band else regime
