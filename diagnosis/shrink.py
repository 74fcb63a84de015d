"""How far the gap shrinks: residuals of two models on the same trials, each stage driven by what was measured."""

from collections.abc import Sequence

import numpy as np

from diagnosis.gap.counts import counts
from diagnosis.gap.recordings import flight
from diagnosis.gap.robot_views import robot_views
from diagnosis.gap.view import Array, Point
from diagnosis.trials import Trial
from schemas.model import Model
from simulator.effects import REGISTRY, value

RESAMPLES = 2000


def measure_shrink(trials: Sequence[Trial], nominal: Model, patched: Model) -> dict[str, float]:
    """Stage -> 1 - RMS gap of `patched` over that of `nominal`, on trials that no fit has seen.

    Stages that the trials do not show are left out. Nothing is fitted.
    """
    shown = flight(trials, nominal)
    difference = point_between(nominal, patched)
    found = {}
    for view in robot_views(shown, nominal):
        before, after = view.gap([{}, difference])
        rms = [float(np.sqrt(np.nanmean((gap / view.floor) ** 2))) for gap in (before, after)]
        found[view.stage] = 1 - rms[1] / rms[0] if rms[0] > 0 else 0.0
    for one, other in zip(counts(trials, nominal), counts(trials, patched), strict=True):
        if one.before > one.floor and other.nominal != one.nominal:
            found[one.stage] = 1 - other.before / one.before
    return found


def point_between(nominal: Model, patched: Model) -> Point:
    """Where the second model's effects differ from the first's."""
    return {
        f"{name}.{p.name}": value(patched, name, p.name)
        for name, effect in REGISTRY.items()
        for p in effect.parameters
        if value(patched, name, p.name) != value(nominal, name, p.name)
    }


def interval(before: Array, after: Array) -> tuple[float, float, float]:
    """1 - sqrt(sum after / sum before) with its 95 % interval: trials drawn anew; squares by trial, [K] each."""
    value_ = 1 - float(np.sqrt(after.sum() / before.sum())) if before.sum() > 0 else 0.0
    k = len(before)
    counts_ = np.random.default_rng(0).multinomial(k, np.full(k, 1 / k), RESAMPLES)
    ratio = np.sqrt((counts_ @ after) / np.maximum(counts_ @ before, 1e-30))
    low, high = np.quantile(1 - ratio, (0.025, 0.975))
    return value_, float(low), float(high)
