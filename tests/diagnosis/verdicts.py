"""Builders of verdicts and their parts, for tests of reports and of the blind benchmark."""

from softarm.diagnosis.rigs.scales import TrackingScales
from softarm.diagnosis.rigs.tracking_effects import tracking_effects
from softarm.schemas.verdict import (
    BestFit,
    CalibratedParameter,
    Estimate,
    Gap,
    Interval,
    NamedEffect,
    Quantity,
    Shrink,
    Verdict,
    Where,
)

SCALES = TrackingScales(
    step_s=0.01, longest_s=20, late_s=0.1, reach=1, top=0.5, commanded=1, rise=1, fall=1, acceleration=10, noise=1e-3
)


def interval(value, low, high):
    """Return an interval that may be infinite."""
    return Interval.model_construct(value=value, low=low, high=high)


def effect(name, *equivalents, stage=(0.5, 0.4, 0.6), chain=None, confidence=None, **parameters):
    """Return a named effect; a parameter is (value, low, high, unit), a shrink (value, low, high)."""
    sizes = {key: Estimate(value=v, low=low, high=high, unit=unit) for key, (v, low, high, unit) in parameters.items()}
    shrink = Shrink(stage=interval(*stage), chain=chain and interval(*chain))
    return NamedEffect(name=name, parameters=sizes, equivalents=equivalents, confidence=confidence, shrink=shrink)


def rms(unit, **values):
    """Return the root mean square of each stage."""
    return {stage: Quantity(value=value, unit=unit) for stage, value in values.items()}


def gap(before=None, after=None, floor=None, ceiling=None, **calibrated):
    """Return gaps, empty where none are given."""
    return Gap(before=before or {}, after=after or {}, floor=floor or {}, ceiling=ceiling or {}, **calibrated)


def verdict(kind, *effects, stage=None, share=(), regime="throughout", gaps=None, **more):
    """Return a verdict of this kind, by default without any gap."""
    where = Where(stage=stage, share=dict(share), regime=regime)
    return Verdict(verdict=kind, where=where, effects=effects, gap=gaps or gap(), **more)


def vocabulary(*stages):
    """Return the effects of servos."""
    return {each.name: each for stage in stages for each in tracking_effects(stage, "rad", SCALES)}


def with_parameters(effects=(), calibration=(), best_fit=()):
    """Return a verdict with parameters of effects, calibration and best fit, each as (path, value, unit)."""
    named = {}
    for path, value, unit in effects:
        name, _, parameter = path.rpartition(".")
        named.setdefault(name, {})[parameter] = Estimate(value=value, low=value, high=value, unit=unit)
    shrink = Shrink(stage=interval(0.5, 0.4, 0.6))
    calibrated = tuple(
        CalibratedParameter(
            name=path, value=x, low=x, high=x, unit=unit, nominal=0, tolerance_low=x, tolerance_high=x, shrink=0
        )
        for path, x, unit in calibration
    )
    of = (NamedEffect(name=name, parameters=each, shrink=shrink) for name, each in named.items())
    fits = {}
    for path, value, unit in best_fit:
        fits.setdefault(path.partition(".")[0], {})[path] = Quantity(value=value, unit=unit)
    before, after = Quantity(value=2.0, unit="rad"), Quantity(value=1.0, unit="rad")
    best = {stage: BestFit(parameters=each, before=before, after=after) for stage, each in fits.items()}
    return verdict("named", *of, calibration=calibrated, best_fit=best)
