"""Texts of a diagnosis: headline, cause, confidence and shrink."""

import math
import re
from dataclasses import replace

import pytest

from softarm.diagnosis import report
from softarm.diagnosis.data.trials import STAGE_NEEDS
from softarm.diagnosis.engine.result import Diagnosis, Rival
from softarm.diagnosis.report import words
from softarm.diagnosis.report.answer import headline
from softarm.schemas.model import Model
from softarm.schemas.verdict import Where
from softarm.simulator.effects import REGISTRY
from tests.diagnosis.report.cases import (
    AXIS,
    CASES,
    DEAD_TIME,
    GONE,
    NOTHING,
    OTHER_DELAY,
    PAIR,
    PAYLOAD,
    STIFFNESS,
    VERDICT,
    alike,
    diagnosis,
    named,
    verdict,
)
from tests.diagnosis.verdicts import effect, gap, interval, rms


def test_a_named_effect_is_reported_with_size_confidence_and_shrink():
    cause, sure, shrinks = report.answer(CASES["named"])
    assert cause == (
        "Missing in the simulator: pressure.dead_time (the regulator starts to react late), delay 61 ms (55 to 68)."
    )
    assert sure == (
        "In blind tests, 94 % of such answers were correct. "
        "81 % of the gap arises in the pressure stage (deflating, above 2 Hz)."
    )
    assert shrinks == (
        "With it corrected in the simulator, the gap of the pressure stage shrinks from 1.2 to 0.31 kPa RMS (74 % "
        "less, 95 % interval 70 to 78) and the gap at the tip shrinks from 20 to 10 mm RMS (50 % less, 95 % interval "
        "40 to 60), on held-out excitations. In the pressure stage, differences below 0.2 kPa count as noise."
    )


def test_an_effect_that_shrinks_the_gap_beside_the_calibration_alone_is_reported_so():
    gap = CASES["named"].verdict.gap
    gap = gap.model_copy(update={"after": gap.after | {"pressure": gap.before["pressure"]}})
    case = replace(CASES["named"], verdict=CASES["named"].verdict.model_copy(update={"gap": gap}))
    assert report.answer(case)[2].startswith(
        "With it corrected in the simulator, the gap of the pressure stage shrinks from 1.2 to 0.21 kPa RMS with the "
        "calibration (not without it) and the gap at the tip shrinks from 20 to 10 mm RMS"
    )


def test_the_shrink_is_stated_for_a_stage_with_a_cause():
    """A rig's largest gap may have none."""
    known = DEAD_TIME.model_copy(update={"name": "servo2.dead_time"})
    gaps = gap(
        rms("rad", servo2=0.06, servo6=0.043),
        rms("rad", servo2=0.03, servo6=0.043),
        rms("rad", servo2=0.001, servo6=0.001),
        calibrated=rms("rad", servo2=0.03, servo6=0.04299999),
    )
    where = Where(stage="servo6", share={"servo6": 0.6, "servo2": 0.4}, regime="throughout")
    of = verdict(verdict="incomplete", effects=(known,), gap=gaps, where=where)
    shrunk = {"servo2": interval(0.5, 0.45, 0.56)}
    _, sure, shrinks = report.answer(diagnosis(verdict=of, nominal=None, patched=None, total_shrink=shrunk))
    assert "60 % of the gap arises in the servo6 stage" in sure
    assert shrinks == (
        "With it corrected in the model, the gap of the servo2 stage shrinks from 0.06 to 0.03 rad RMS (50 % less, "
        "95 % interval 45 to 56), on held-out excitations. In the servo2 stage, differences below 0.001 rad count as "
        "noise. No effect is named for the servo6 stage."
    )
    assert words.shrinks(diagnosis(verdict=of), "servo6").startswith("shrinks from 0.043 to 0.043 rad RMS (")


def test_an_effect_that_the_robot_lacks_and_an_effect_of_another_size_are_distinguished():
    nominal = Model()
    effects = {n: dict(p) for n, p in nominal.effects.items() if n != GONE.name}
    effects |= {"pressure.dead_time": {"delay": 0.0612}, "rail.delay": {"delay": 0.05}}
    case = replace(CASES["incomplete"], patched=nominal.model_copy(update={"effects": effects}))
    cause, sure, _ = report.answer(case)
    assert "Missing in the simulator: pressure.dead_time (the regulator starts to react late), delay 61 ms" in cause
    assert "Wrong size in the simulator: rail.delay (" in cause
    assert "In the simulator but not on the robot: observation.finite_difference (" in cause
    assert cause.endswith("More of the gap could be explained.")
    assert "80–94 %" in sure


def test_a_set_is_reported_whole_and_after_the_single_effects():
    cause, _, _ = report.answer(CASES["set"])
    either = "either pressure.dead_time or pressure.lag (this data cannot separate them)."
    assert cause == f"Missing in the simulator: {either}"
    cause, _, _ = report.answer(named(PAIR, PAYLOAD))
    assert cause == f"Missing in the simulator: arm.payload (mass 30 g), and {either}"


MANY = tuple(DEAD_TIME.model_copy(update={"name": f"joint{i % 6}.effect{i}"}) for i in range(26))
WIDE = alike(DEAD_TIME, "pressure.lag", "pressure.deadband")
STRONG = effect("rail.force_limit", force=(math.inf, 20.0, math.inf, "N"))


@pytest.mark.parametrize(
    ("effects", "says"),
    [
        ((DEAD_TIME,), "The regulator reacts 61 ms late"),
        ((STRONG,), "The drive pushes with at most 20 N or more"),
        (MANY, "26 effects in 6 stages"),
        (
            MANY[:4],
            "joint0.effect0 (delay 61 ms), joint1.effect1 (delay 61 ms), "
            "joint2.effect2 (delay 61 ms), and joint3.effect3 (delay 61 ms)",
        ),
        ((alike(DEAD_TIME, *(e.name for e in MANY)),), "One of 27 effects in pressure"),
        ((WIDE, WIDE), "2 effects in pressure, each with alternatives"),
        (
            (PAIR, OTHER_DELAY),
            "The cart reacts 50 ms late, and either the regulator reacts 61 ms late, or pressure.lag looks the same",
        ),
    ],
)
def test_a_headline_is_a_plain_sentence_with_sizes_or_a_number_of_effects(effects, says):
    assert headline(named(*effects)) == says


def test_a_delay_has_no_sign():
    """At a joint, the search also allows a delay half a sample below zero."""
    late = DEAD_TIME.model_copy(update={"name": "axis.dead_time"})
    (delay,) = AXIS["axis.dead_time"].parameters
    below_zero = replace(AXIS["axis.dead_time"], parameters=(replace(delay, low=-0.01),))
    known = AXIS | {"axis.dead_time": below_zero}
    found = Diagnosis(verdict(effects=(late,)), None, None, (), held_out="block", vocabulary=known)
    assert headline(found) == "Axis reacts 61 ms late"


def test_many_effects_are_grouped_by_law():
    many = [DEAD_TIME.model_copy(update={"name": f"servo{i}.lag"}) for i in (1, 2, 3)]
    many.append(alike(DEAD_TIME.model_copy(update={"name": "servo1.deadband"}), "servo1.backlash"))
    many.append(alike(DEAD_TIME.model_copy(update={"name": "servo2.backlash"}), "servo2.deadband"))
    cause, _, _ = report.answer(diagnosis(verdict=verdict(effects=tuple(many)), nominal=None, patched=None))
    assert cause == (
        "Missing in the model, 5 effects in 3 stages: "
        "lag (servo1, servo2 and servo3), backlash or deadband (servo1 and servo2)."
    )


@pytest.mark.parametrize(
    ("after_kpa", "shrink", "says"),
    [
        (0.012, (0.99, 0.9889, 0.9914), "99 % less, 95 % interval 98.9 to 99.1"),  # a digit separates the bounds
        (1.32, (-0.1, -0.2, 0.05), "10 % more, 95 % interval -5 to 20"),
    ],
)
def test_a_shrink_has_an_interval_with_enough_digits_and_the_right_sign(after_kpa, shrink, says):
    gap = VERDICT.gap.model_copy(update={"after": rms("kPa", pressure=after_kpa)})
    case = diagnosis(verdict=verdict(gap=gap), total_shrink={"pressure": interval(*shrink)})
    assert words.shrinks_by(case, "pressure") == says


@pytest.mark.parametrize(
    ("bounds", "unit", "says"),
    [
        ((23.0, 20.0, math.inf), "rad/s^2", "23 rad/s^2 (20 or more)"),
        ((math.inf, 20.0, math.inf), "rad/s^2", "20 rad/s^2 or more"),
        ((0.0612, 0.0551, 0.0683), "s", "61 ms (55 to 68)"),
        ((2.0, 1.96, 2.04), "N", "2.00 N (1.96 to 2.04)"),
        ((2.0, 2.0, 2.0), "N", "2 N (2 to 2)"),
    ],
)
def test_an_interval_has_the_digits_that_it_deserves(bounds, unit, says):
    assert words.interval(interval(*bounds), unit) == says


@pytest.mark.parametrize(("times", "stated"), [(2.0, False), (90.0, True)])
def test_none_states_first_what_a_model_leaves_far_above_the_noise_of_the_signals(times, stated):
    (stage, *_) = CASES["none"].verdict.gap.floor
    case = replace(CASES["none"], noise={stage: times})
    cause, sure, _ = report.answer(case)
    assert cause.startswith("No cause" if stated else "No gap")
    assert headline(case) == ("No cause found" if stated else "No gap")
    assert (f"The {stage} stage leaves " in sure and "90 times the noise of its signals" in sure) == stated


def test_none_names_the_stages_that_the_recordings_do_not_show():
    """Without a tracked marker, nothing was compared there: the arm may be any."""
    _, _, then = report.answer(CASES["none"])
    assert then.startswith("The recordings do not show rail, arm, mocap, observation and clock. In the other stages, ")
    small, floor = (rms("m", **dict.fromkeys(STAGE_NEEDS, value)) for value in (0.001, 0.1))
    whole = NOTHING.model_copy(update={"gap": gap(small, small, floor)})
    _, _, then = report.answer(replace(CASES["none"], verdict=whole))
    assert then.startswith("Nothing is missing in the simulator. ")


def test_none_with_a_gap_above_its_floor_does_not_claim_agreement():
    late = gap(rms("s", clock=0.0067), rms("s", clock=0.0067), rms("s", clock=0.0012))
    cause, sure, then = report.answer(replace(CASES["none"], verdict=NOTHING.model_copy(update={"gap": late})))
    assert cause == "No cause of a gap between robot and simulator was found on this data."
    assert "6.7 ms RMS; differences below 1.2 ms count as noise" in sure
    assert "no proof that the gap is zero" in sure
    assert "agree" not in cause + sure + then
    assert "Calibration" not in then
    known = NOTHING.model_copy(update={"gap": late, "calibration": (STIFFNESS,)})
    late.calibrated.update(rms("s", clock=0.0013))
    assert "goes from 6.7 to 1.3 ms RMS, held out" in report.answer(replace(CASES["none"], verdict=known))[2]
    assert headline(replace(CASES["none"], verdict=NOTHING.model_copy(update={"gap": late}))) == "No cause found"


def test_an_unknown_cause_names_no_effect_but_the_share_of_the_closest():
    cause, sure, then = report.answer(CASES["unknown"])
    assert "No known effect explains it" in cause
    assert "a flexible model could remove 75 % of it" in sure
    assert "pressure.lag, removes 76 %. That is as much, but it failed other checks" in sure
    assert "stays unchanged" in then
    weak = (Rival("pressure.lag", 0.1, interval(0.0, 0.0, 0.1), {}),)
    _, sure, _ = report.answer(replace(CASES["unknown"], rivals=weak))
    assert sure.endswith("The closest known effect, pressure.lag, removes 10 %.")


def test_every_effect_of_the_arm_has_a_plain_sentence_with_its_size():
    for known in REGISTRY.values():
        sizes = {p.name: (p.exemplar, p.low, p.high, p.unit) for p in known.parameters}
        text = headline(named(effect(known.name, **sizes)))
        assert known.name not in text
        assert text.lower() != known.meaning.lower()
        assert not re.search(r"[{}]", text)
        assert re.search(r"\d", text) or not re.search("{(?!stage)", known.plain), text
