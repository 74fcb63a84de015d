"""Diagnoses for the tests of the report."""

import numpy as np

from softarm.diagnosis.engine.result import Diagnosis, Overlay, Regime, Rival, Spectrum, Unexplained
from softarm.schemas.model import Model
from softarm.schemas.verdict import CalibratedParameter, NextExperiment, Task
from tests.diagnosis.verdicts import effect, gap, interval, rms, vocabulary
from tests.diagnosis.verdicts import verdict as built

NASTY = "</script><script>alert(1)</script> \"quoted\" & 'so'"
DEAD_TIME = effect(
    "pressure.dead_time",
    stage=(0.74, 0.70, 0.78),
    chain=(0.5, 0.4, 0.6),
    confidence=0.94,
    delay=(0.0612, 0.0551, 0.0683, "s"),
)
OTHER_DELAY = effect("rail.delay", confidence=0.8, delay=(0.05, 0.045, 0.055, "s"))
PAYLOAD = effect("arm.payload", mass=(0.03, 0.028, 0.033, "kg"))
GONE = effect("observation.finite_difference", confidence=0.9)
STIFFNESS = CalibratedParameter(
    name="arm.stiffness.scale",
    nominal=0.0,
    value=0.012,
    low=0.01,
    high=0.014,
    unit="-",
    tolerance_low=-0.06,
    tolerance_high=0.06,
    shrink=0.62,
    at_edge=True,
)
VERDICT = built(
    "named",
    DEAD_TIME,
    stage="pressure",
    share={"pressure": 0.81, "arm": 0.19},
    regime="deflating, above 2 Hz",
    gaps=gap(
        before=rms("kPa", pressure=1.2) | rms("m", arm=0.004, chain=0.02),
        after=rms("kPa", pressure=0.31) | rms("m", arm=0.004, chain=0.01),
        floor=rms("kPa", pressure=0.2) | rms("m", arm=0.003, chain=0.005),
        ceiling=rms("kPa", pressure=0.3),
        calibrated=rms("kPa", pressure=0.21) | rms("m", arm=0.002, chain=0.004),
    ),
    calibration=(STIFFNESS,),
    task=Task(success_real=0.6, success_nominal=0.9),
    next_experiment=NextExperiment(
        excitation="free-decay", separates=("arm.damping", "arm.drag"), expect={"arm.drag": "faster at first"}
    ),
    warnings=(f"odd {NASTY}",),
)


def diagnosis(**changes):
    """A diagnosis with one of everything."""
    draw = np.random.default_rng(1)
    t = np.arange(400) / 100
    measured = np.sin(t) + 0.01 * draw.normal(size=400)
    measured[50:60] = np.nan
    frequency = np.linspace(0.1, 50, 700)
    nominal = Model()
    values = {
        "verdict": VERDICT,
        "nominal": nominal,
        "patched": nominal.model_copy(update={"effects": {**nominal.effects, "pressure.dead_time": {"delay": 0.0612}}}),
        "trials": ((NASTY, "seed", 4.0),),
        "overlays": (
            Overlay("arm", NASTY, "seed", "tip y", "m", t + 1e-4 * draw.uniform(size=400), measured, np.sin(t), None),
            Overlay("pressure", NASTY, "seed", "pressure", "kPa", t, measured, np.sin(t - 0.06), np.sin(t)),
        ),
        "spectra": (Spectrum("pressure", "kPa", frequency, 1 / frequency, 0.1 / frequency, 0.01),),
        "regimes": (Regime("pressure", "inflating", 1200, 1.1, 0.3, "kPa"),),
        "rivals": (
            Rival(DEAD_TIME.name, 0.74, interval(0.7, 0.6, 0.8), {"pressure.dead_time.delay": 0.0612}, "named"),
            Rival("pressure.lag", 0.76, interval(0.01, -0.02, 0.03), {"pressure.lag.inflate": 0.2}, NASTY),
        ),
        "unexplained": (Unexplained("arm", 0.4, (("sign of the rate", 0.3), (NASTY, 0.1))),),
        "seconds": 12.0,
        "held_out": "kind",
        "total_shrink": {"pressure": DEAD_TIME.shrink.stage, "chain": DEAD_TIME.shrink.chain},
    }
    return Diagnosis(**values | changes)


def verdict(**changes):
    return VERDICT.model_copy(update=changes)


def named(*effects):
    return diagnosis(verdict=verdict(effects=effects))


def alike(effect, *equivalents):
    return effect.model_copy(update={"equivalents": equivalents})


PAIR = alike(DEAD_TIME, "pressure.lag")
QUIET = rms("kPa", pressure=0.1)
NOTHING = built("none", regime="nowhere", gaps=gap(QUIET, QUIET, rms("kPa", pressure=0.2)))
OWN_RIG = built(
    "named",
    DEAD_TIME.model_copy(update={"name": "axis.deadband"}),
    stage="axis",
    share={"axis": 1.0},
    gaps=gap(rms("rad", axis=0.1), rms("rad", axis=0.05), rms("rad", axis=0.01)),
)
AXIS = vocabulary("axis")
CASES = {
    "named": diagnosis(),
    "set": named(PAIR),
    "incomplete": diagnosis(verdict=verdict(verdict="incomplete", effects=(DEAD_TIME, OTHER_DELAY, GONE))),
    "unknown": diagnosis(verdict=verdict(verdict="unknown", effects=()), patched=None),
    "none": Diagnosis(NOTHING, Model(), None, ()),
    "own rig": Diagnosis(OWN_RIG, None, None, (("a", "free", 1.0),), held_out="block", vocabulary=AXIS),
}
