"""Tests of the diagnosis report: its texts, its drawings, and a page that loads nothing."""

import json
import math
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from softarm.diagnosis import report
from softarm.diagnosis.engine.result import Diagnosis, Overlay, Regime, Rival, Spectrum, Unexplained
from softarm.diagnosis.report import words
from softarm.diagnosis.report.answer import headline
from softarm.schemas.model import Model
from softarm.schemas.verdict import CalibratedParameter, NextExperiment, Task, Where
from softarm.simulator.effects import REGISTRY
from tests.diagnosis.verdicts import effect, gap, interval, rms, vocabulary
from tests.diagnosis.verdicts import verdict as built

NASTY = "</script><script>alert(1)</script> \"quoted\" & 'so'"
VOID = {"meta", "br", "input"}


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


class Page(HTMLParser):
    """A page as a reader sees it; fails where tags do not close in order."""

    def __init__(self, text):
        super().__init__()
        self.open, self.text, self.tags, self.links, self.data, self.ids = [], [], [], [], "", []
        self.policy = None
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.tags.append(tag)
        self.ids += [attributes["id"]] if "id" in attributes else []
        self.links += [v for k, v in attrs if k in ("src", "href", "action", "srcset", "data", "poster")]
        if tag not in VOID:
            self.open.append((tag, attributes.get("id")))

    def handle_startendtag(self, tag, attrs):
        self.tags.append(tag)
        if ("http-equiv", "Content-Security-Policy") in attrs:
            self.policy = dict(attrs)["content"]

    def handle_endtag(self, tag):
        assert self.open.pop()[0] == tag

    def handle_data(self, data):
        if self.open and self.open[-1] == ("script", "data"):
            self.data += data
        elif self.open and self.open[-1][0] not in ("script", "style"):
            self.text.append(data)

    @property
    def words(self):
        return " ".join(" ".join(self.text).split())


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_a_page_is_whole_and_fetches_nothing(case):
    text = report.render(case)
    page = Page(text)
    assert page.tags.count("h1") == 1
    assert page.tags.count("script") == 2  # the data and the plotter; no name of a trial has become one
    assert page.links
    assert all(link.startswith("#") and link[1:] in page.ids for link in page.links)
    assert "default-src 'none'" in page.policy
    assert not re.search(r"https?:|@import|url\(", text.replace("https://github.com/leeoniya/uPlot", ""))
    assert text == report.render(case)


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_the_answer_is_three_texts_and_the_page_has_them_or_a_card_for_each_cause(case):
    answer, named = report.answer(case), case.verdict.effects
    assert len(answer) == 3
    page = Page(report.render(case)).words.replace("\N{NO-BREAK SPACE}", " ")
    cards = [f"confidence: {'not rated' if e.confidence is None else f'{e.confidence:.0%}'}" for e in named]
    for text in cards or answer:
        assert cards or text.endswith(".")
        assert re.sub(r"\s", "", text) in re.sub(r"\s", "", page)


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


def test_sets_that_explain_as_much_are_reported():
    other = ("pressure.leak", "rail.gain")
    case = diagnosis(verdict=verdict(effects=(DEAD_TIME, PAYLOAD), equal_sets=(other,)))
    assert "The recordings fit as well: pressure.leak with rail.gain." in report.answer(case)[0]
    assert "pressure.leak with rail.gain" in Page(report.render(case)).words


def test_an_effect_without_confidence_is_shown_as_not_rated():
    bare = OTHER_DELAY.model_copy(update={"confidence": None})
    page = Page(report.render(named(DEAD_TIME, bare))).words
    assert "confidence: 94 %" in page
    assert page.count("not rated") == 2  # card, table
    _, sure, _ = report.answer(named(DEAD_TIME, bare))
    assert "94 % of such answers were correct; not rated: rail.delay" in sure
    _, sure, _ = report.answer(named(bare))
    assert sure.startswith("The confidence of this answer has not been measured")
    page = Page(report.render(named(bare))).words
    assert "confidence: not rated" in page
    assert "Confidence is the share" not in page


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


def test_an_effect_that_stages_share_is_one_cause():
    both = ("tilt", "pan")
    pan, tilt = (DEAD_TIME.model_copy(update={"name": f"{s}.payload", "shared_by": both}) for s in ("pan", "tilt"))
    other = DEAD_TIME.model_copy(update={"name": "pan.lag"})
    found = diagnosis(verdict=verdict(effects=(tilt, pan, other)), nominal=None, patched=None)
    assert found.verdict.causes == (tilt, other)
    assert headline(found) == "Payload of tilt and pan (delay 61 ms), and pan.lag (delay 61 ms)"
    assert "payload of tilt and pan (delay 61 ms) and pan.lag" in report.answer(found)[0]
    page = Page(report.render(found)).words
    assert page.count("tilt.payload and pan.payload") == 1
    assert "74 % (70 to 78) of the tilt gap and 74 % (70 to 78) of the pan gap" in page
    shown = report.paragraphs(found)
    assert shown["tilt"].startswith("missing in the model: payload of tilt and pan, delay 61 ms (55 to 68).")
    assert shown["pan"].startswith("missing in the model: the payload stated for tilt; missing in the model: pan.lag")
    more = pan.model_copy(update={"parameters": {**pan.parameters, "y": pan.parameters["delay"]}})
    found = diagnosis(verdict=verdict(effects=(tilt, more, other)), nominal=None, patched=None)
    assert "payload of tilt and pan, delay 61 ms (55 to 68), y 61 ms" in report.paragraphs(found)["pan"]


def test_a_set_that_stages_share_names_them_all():
    late = {"shared_by": ("tilt", "pan")}
    tilt, pan = (
        alike(DEAD_TIME.model_copy(update={"name": f"{s}.dead_time"} | late), f"{s}.latency") for s in ("tilt", "pan")
    )
    found = diagnosis(verdict=verdict(effects=(tilt, pan)), nominal=None, patched=None)
    assert report.answer(found)[0] == (
        "Missing in the model: either dead_time of tilt and pan or latency of tilt and pan (this data cannot separate "
        "them)."
    )
    assert "tilt.dead_time and pan.dead_time , or latency of tilt and pan" in Page(report.render(found)).words


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


def test_every_shrink_has_its_interval_or_states_that_it_is_unknown():
    shrink = "pressure gap, 74 % less, 95 % interval"
    assert f"{shrink} 70 to 78" in Page(report.render(CASES["named"])).words
    several = CASES["incomplete"]
    assert "pressure gap, 74 % less, interval not known" in Page(report.render(several)).words
    joint = replace(several, total_shrink={"pressure": interval(0.74, 0.61, 0.8), "chain": interval(0.5, 0.45, 0.55)})
    page = Page(report.render(joint)).words
    assert f"{shrink} 61 to 80" in page
    assert "tip, whole chain, 50 % less, 95 % interval 45 to 55" in page
    assert "interval not known" not in page


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


def test_each_stage_has_a_paragraph_with_effects_sizes_shrink_and_rest():
    shown = report.paragraphs(CASES["named"])
    assert list(shown) == ["pressure", "arm", "chain"]
    assert shown["pressure"] == (
        "missing in the simulator: pressure.dead_time (the regulator starts to react late), delay 61 ms (55 to 68). "
        "With it corrected, the gap shrinks from 1.2 to 0.31 kPa RMS (74 % less, 95 % interval 70 to 78) on held-out "
        "excitations. The rest is 1.5 times the noise floor of 0.2 kPa."
    )
    assert shown["arm"] == "4 mm RMS, 1.3 times the noise floor of 3 mm. No effect is named for it."
    assert "from 20 to 10 mm RMS (50 % less, 95 % interval 40 to 60)" in shown["chain"]


def test_a_long_stage_name_leaves_room_for_its_share():
    long = "left_forearm_roll_joint"
    where = Where(stage=long, share={long: 0.004}, regime="throughout")
    case = replace(CASES["own rig"], verdict=OWN_RIG.model_copy(update={"where": where}))
    page = report.render(case)
    assert f">{long[:12]}…<" in page
    assert "&lt; 1 %" in page


def test_the_table_of_a_rig_explains_each_member_of_a_set():
    of_a_set = effect("axis.deadband", "axis.backlash", width=(0.02, 0.01, 0.03, "rad"))
    case = replace(CASES["own rig"], verdict=OWN_RIG.model_copy(update={"effects": (of_a_set,)}))
    page = Page(report.render(case)).words
    for name in ("axis.deadband", "axis.backlash"):
        assert AXIS[name].meaning in page
    assert "width 0.020 rad (0.010 to 0.030)" in page
    shown = report.paragraphs(case)["axis"]
    assert "this data cannot separate them. For axis.deadband, width 0.020 rad" in shown
    assert "named, not separable" in page


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


@pytest.mark.parametrize(
    ("held_out", "expected"),
    [
        ("kind", "on held-out kinds of excitation"),
        ("trial", "no kind of excitation was held out"),
        ("block", "the error on new motions was not measured"),
    ],
)
def test_the_method_states_the_held_out_data_of_this_diagnosis(held_out, expected):
    page = Page(report.render(diagnosis(held_out=held_out))).words
    assert expected in page[page.rindex("Method") :]


def test_an_unknown_cause_names_no_effect_but_the_share_of_the_closest():
    cause, sure, then = report.answer(CASES["unknown"])
    assert "No known effect explains it" in cause
    assert "a flexible model could remove 75 % of it" in sure
    assert "pressure.lag, removes 76 %. That is as much, but it failed other checks" in sure
    assert "stays unchanged" in then
    weak = (Rival("pressure.lag", 0.1, interval(0.0, 0.0, 0.1), {}),)
    _, sure, _ = report.answer(replace(CASES["unknown"], rivals=weak))
    assert sure.endswith("The closest known effect, pressure.lag, removes 10 %.")


def test_an_unknown_cause_without_a_stage_names_none():
    """Structure in a part of a residual within its floor: something is missing, and no energy is left to locate it."""
    nowhere = Where(stage=None, share={}, regime="nowhere")
    case = diagnosis(verdict=verdict(verdict="unknown", effects=(), where=nowhere), patched=None)
    assert headline(case) == "An unknown effect"
    cause, _, _ = report.answer(case)
    assert cause == "There is a gap between robot and simulator. No known effect explains it."
    shown = Page(report.render(case)).words
    assert "None" not in shown
    assert "nowhere" not in shown


def test_each_overlay_is_on_the_page_and_the_diagnosed_stage_comes_first():
    case = CASES["named"]
    data = json.loads(Page(report.render(case)).data)
    assert data["choices"] == ["stage", "trial", "channel"]
    assert data["first"] == 1
    for item, overlay in zip(data["items"], case.overlays, strict=True):
        assert item["chosen"] == [overlay.stage, NASTY, overlay.channel]
        assert list(item["curves"]) == ["measured", "nominal", "patched"][: 2 if overlay.patched is None else 3]
    assert [item["band"] for item in data["items"]] == [0.003, 0.2]


EVIDENCE = (
    "softarm excite --plan verdict.json",
    "faster at first",
    "the arm is bent, released",
    "inflating",
    "1 200",
    "pressure.lag",
    "inflate 0.2 s",
    "1 % (-2 to 3)",
    "sign of the rate",
    "Calibration: 1 parameter is off within tolerance; corrected, the gap at the tip goes from 10 to 4 mm RMS",
    "arm.stiffness.scale",
    "0.0120 (0.0100 to 0.0140) -0.06 to 0.06, at the edge",
    "absent 0.0612 s",
    "on the robot 60 %",
    "in the nominal simulator 90 %",
    "took 12 s",
    "Unique share: how much of the gap (RMS) disappears when this effect joins",
    "Tip: the tip's position, simulated from commands alone",
    "50 % (40 to 60) of the tip's (10 mm)",
    "The share compares squared gaps, each in units of its stage's noise floor.",
)


def test_every_part_of_the_evidence_is_on_the_page():
    page = Page(report.render(CASES["named"])).words
    for piece in EVIDENCE:
        assert piece in page
    assert "in the patched simulator" not in page  # its success is not known


def test_a_further_section_keeps_its_markup_and_escapes_its_title(tmp_path):
    path = tmp_path / "report.html"
    report.write(CASES["named"], path, further=[("Policy <now>", "<p>it <em>swings</em></p>")])
    text = path.read_text(encoding="utf-8")
    assert "<h2>Policy &lt;now&gt;</h2><p>it <em>swings</em></p>" in text
    Page(text)


def test_every_effect_of_the_arm_has_a_plain_sentence_with_its_size():
    for known in REGISTRY.values():
        sizes = {p.name: (p.exemplar, p.low, p.high, p.unit) for p in known.parameters}
        text = headline(named(effect(known.name, **sizes)))
        assert known.name not in text
        assert text.lower() != known.meaning.lower()
        assert not re.search(r"[{}]", text)
        assert re.search(r"\d", text) or not re.search("{(?!stage)", known.plain), text
