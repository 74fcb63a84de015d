"""Shrink of the robot's gaps from a nominal to a patched model on fresh trials, without a fit."""

from collections.abc import Sequence

import numpy as np

from softarm.diagnosis.answer.evidence import rms
from softarm.diagnosis.data.trials import Trial
from softarm.diagnosis.engine.view import Point
from softarm.diagnosis.robot.chain import tip_gap
from softarm.diagnosis.robot.counts import counts
from softarm.diagnosis.robot.drive import SERVO, with_servo
from softarm.diagnosis.robot.trial_grid import TrialGrid, on_grid
from softarm.diagnosis.robot.views import ON_MOTOR, robot_views
from softarm.schemas.model import Model
from softarm.simulator.effects import REGISTRY, value


def measure_shrink(trials: Sequence[Trial], nominal: Model, patched: Model) -> dict[str, float]:
    """Return 1 - RMS gap of `patched` over that of `nominal`, by stage and for the tip (`chain`).

    Nothing is fitted. Stages that the trials do not show are left out. A servo of the patched model also drives the
    nominal one, as in the verdict, so that no effect is credited with it.
    """
    nominal = with_servo(nominal) if SERVO in patched.effects else nominal
    shown = on_grid(trials, nominal)
    difference = _point_between(nominal, patched)
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


def _point_between(nominal: Model, patched: Model) -> Point:
    """Return the parameters in which the second model's effects differ from the first's."""
    return {
        f"{name}.{p.name}": value(patched, name, p.name)
        for name, effect in REGISTRY.items()
        for p in effect.parameters
        if value(patched, name, p.name) != value(nominal, name, p.name)
    }
