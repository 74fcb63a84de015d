"""Calibration of the robot's nominal model: its parameters within tolerance, in the verdict and in the patch."""

from collections.abc import Mapping, Sequence

import numpy as np

from softarm.common.quantity import PURE
from softarm.diagnosis.answer.calibration import Calibrated
from softarm.diagnosis.answer.evidence import rms
from softarm.diagnosis.engine.view import Point
from softarm.diagnosis.robot.comparison import Comparison
from softarm.diagnosis.robot.floors import tip_gap_with
from softarm.diagnosis.robot.views import with_joints
from softarm.schemas.model import Model
from softarm.simulator.effects import REGISTRY, find, value


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
