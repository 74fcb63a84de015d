"""Tests of the next recordings in words: the planned experiment, and a way to separate each set of effects."""

import numpy as np

from softarm.diagnosis import report
from softarm.diagnosis.engine.result import Diagnosis, Overlay
from softarm.diagnosis.report import following
from softarm.schemas.model import Model
from softarm.schemas.verdict import NextExperiment
from tests.diagnosis.verdicts import effect, gap, rms, verdict, vocabulary

VOCABULARY = vocabulary("servo1", "servo2", "servo3")


def diagnosis(*effects, plan=None, nominal=None, overlays=()):
    """Return a diagnosis with these effects, of a rig unless there is a nominal model of the robot."""
    kind, stage = "named" if effects else "unknown", "servo1" if overlays else None
    gaps = gap(floor=rms("rad", servo1=0.01))
    found = verdict(kind, *effects, stage=stage, gaps=gaps, next_experiment=plan)
    return Diagnosis(found, nominal, None, (), overlays, vocabulary={} if nominal else VOCABULARY)


def test_every_set_has_an_experiment_that_separates_it_or_a_note_that_none_is_known():
    def steps(*equivalents):
        return report.steps(diagnosis(effect("pressure.dead_time", *equivalents), nominal=Model()))

    assert steps("pressure.lag") == [
        "To separate dead_time and lag (pressure): a step: flat foot or slope at once; a multisine over a decade."
    ]
    (nothing,) = steps("mocap.scale")
    assert nothing.startswith("To separate mocap.scale and pressure.dead_time: no experiment is known")
    assert "dead_time and deadband: ramps of several slopes" in steps("pressure.lag", "pressure.deadband")[0]


def test_the_separation_of_two_effects_is_symmetric():
    case = diagnosis(nominal=Model())
    for one, other in (("pressure.lag", "pressure.dead_time"), ("arm.stiffness", "arm.muscle_gain")):
        assert following.separation(case, one, other) == following.separation(case, other, one) != ""
    of_a_rig = following.separation(diagnosis(), "servo1.deadband", "servo1.backlash")
    assert of_a_rig.startswith("reversals under load")


def test_sets_of_the_same_laws_share_a_sentence():
    plays = effect("servo1.deadband", "servo1.backlash"), effect("servo2.backlash", "servo2.deadband")
    first, second = report.steps(diagnosis(*plays, effect("servo3.lag", "servo3.rate_limit")))
    assert first.startswith("To separate backlash and deadband (servo1 and servo2): reversals under load")
    assert second.startswith("To separate lag and rate_limit (servo3): steps of several sizes")


def asked(excitation, **expect):
    """Return a diagnosis of a rig that asks for a recording."""
    pair, expect = ("servo1.deadband", "servo1.lag"), {f"servo1.{name}": text for name, text in expect.items()}
    return diagnosis(effect(pair[0]), plan=NextExperiment(excitation=excitation, separates=pair, expect=expect))


def test_the_robot_gets_a_flight_and_another_rig_a_recording():
    plan = NextExperiment(excitation="free-decay", separates=(), expect={})
    assert report.flight(diagnosis(plan=plan, nominal=Model())).name == "free-decay"
    case = asked("slow ramps", lag="a slope", deadband="a step")
    assert report.flight(case) is None
    assert report.steps(case) == ["To separate servo1.deadband and servo1.lag, record slow ramps."]
    assert "softarm excite" not in report.render(case)
    assert "a slope" in report.render(case)
    (alike,) = report.steps(asked("slow ramps", lag="a slope or none", deadband="a slope or none"))
    assert alike == "To separate servo1.deadband and servo1.lag, record slow ramps (a slope or none)."
    assert report.steps(asked("no experiment in the list separates these")) == [
        "servo1.deadband and servo1.lag: no experiment in the list separates these."
    ]


def test_an_unknown_cause_of_a_rig_requests_repeats_of_the_worst_recording():
    t = np.arange(400) / 100
    overlays = tuple(
        Overlay("servo1", name, "steps", "position", "rad", t, np.sin(t), np.sin(t) - gap, None)
        for name, gap in (("calm", 0.01), ("worst", 0.2))
    )
    (step,) = report.steps(diagnosis(overlays=overlays))
    assert step.startswith("Repeat worst about five times; it shows the gap of servo1 best")
