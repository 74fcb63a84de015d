"""The report: whatever was found, one page that says it in words, draws it and fetches nothing."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from softarm.diagnosis import report
from softarm.diagnosis.engine.result import Diagnosis, Leftover, Overlay, Regime, Rival, Spectrum
from softarm.diagnosis.report import following, overlays, words
from softarm.diagnosis.report.answer import headline
from softarm.diagnosis.rigs.vocabulary import effects
from softarm.pages import plot
from softarm.schemas.model import Model
from softarm.schemas.verdict import (
    Estimate,
    Gap,
    Interval,
    NamedEffect,
    NextExperiment,
    Quantity,
    Shrink,
    Task,
    Verdict,
    Where,
)

NASTY = "</script><script>alert(1)</script> \"quoted\" & 'so'"
VOID = {"meta", "br", "input"}


def interval(value, low, high):
    return Interval(value=value, low=low, high=high)


def rms(unit, **values):
    return {stage: Quantity(value=value, unit=unit) for stage, value in values.items()}


DEAD_TIME = NamedEffect(
    name="pressure.dead_time",
    parameters={"delay": Estimate(value=0.0612, low=0.0551, high=0.0683, unit="s")},
    confidence=0.94,
    shrink=Shrink(stage=interval(0.74, 0.70, 0.78), chain=interval(0.5, 0.4, 0.6)),
)
OTHER_DELAY = NamedEffect(
    name="rail.delay",
    parameters={"delay": Estimate(value=0.05, low=0.045, high=0.055, unit="s")},
    confidence=0.8,
    shrink=Shrink(stage=interval(0.3, 0.2, 0.4)),
)
GONE = NamedEffect(
    name="observation.finite_difference", parameters={}, confidence=0.9, shrink=Shrink(stage=interval(0.3, 0.2, 0.4))
)
VERDICT = Verdict(
    verdict="named",
    where=Where(stage="pressure", share={"pressure": 0.81, "arm": 0.19}, regime="deflating, above 2 Hz"),
    effects=(DEAD_TIME,),
    gap=Gap(
        before=rms("kPa", pressure=1.2) | rms("m", arm=0.004, chain=0.02),
        after=rms("kPa", pressure=0.31) | rms("m", arm=0.004, chain=0.01),
        floor=rms("kPa", pressure=0.2) | rms("m", arm=0.003, chain=0.005),
        ceiling=rms("kPa", pressure=0.3),
    ),
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
            Rival((DEAD_TIME.name,), 0.74, interval(0.7, 0.6, 0.8), {"pressure.dead_time.delay": 0.0612}, "named"),
            Rival(("pressure.lag",), 0.5, interval(0.01, -0.02, 0.03), {"pressure.lag.inflate": 0.2}, NASTY),
            Rival(("pressure.dead_time", "pressure.lag"), 0.76, None, {}),
        ),
        "leftovers": (Leftover("arm", 0.4, (("sign of the rate", 0.3), (NASTY, 0.1))),),
        "nuisances": {"arm.stiffness.scale": 0.01},
        "seconds": 12.0,
        "held_out": "kind",
    }
    return Diagnosis(**values | changes)


def verdict(**changes):
    return VERDICT.model_copy(update=changes)


NOTHING = Verdict(
    verdict="none",
    where=Where(stage=None, share={}, regime=""),
    gap=Gap(before=rms("kPa", pressure=0.1), after={}, floor=rms("kPa", pressure=0.2), ceiling={}),
)
OWN_RIG = Verdict(
    verdict="named",
    where=Where(stage="axis", share={"axis": 1.0}, regime=""),
    effects=(DEAD_TIME.model_copy(update={"name": "axis.deadband"}),),
    gap=Gap(before=rms("rad", axis=0.1), after=rms("rad", axis=0.05), floor={}, ceiling={}),
)
AXIS = {effect.name: effect for effect in effects("tracking", "axis", "rad")}
CASES = {
    "named": diagnosis(),
    "set": diagnosis(verdict=verdict(effects=(DEAD_TIME.model_copy(update={"equivalents": ("pressure.lag",)}),))),
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
    assert not re.search(r"https?:|@import|url\(", text)
    assert text == report.render(case)


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_the_answer_is_three_sentences_and_stands_on_the_page(case):
    answer = report.answer(case)
    assert len(answer) == 3
    page = Page(report.render(case)).words.replace("\N{NO-BREAK SPACE}", " ")
    for sentence in answer:
        assert sentence.endswith(".")
        assert re.sub(r"\s", "", sentence) in re.sub(r"\s", "", page)


def test_the_named_effect_is_told_with_its_value_certainty_and_gain():
    what, sure, shrinks = report.answer(CASES["named"])
    assert what == "The simulator lacks pressure.dead_time: the regulator starts to react late; delay 61 ms (55 to 68)."
    assert "94 %" in sure
    assert "81 % of the gap arises in the pressure stage (deflating, above 2 Hz)" in sure
    assert "the pressure stage's gap shrinks from 1.2 to 0.31 kPa RMS (74 % less, 95 % interval 70 to 78)" in shrinks
    assert "the tip's over the whole chain shrinks from 20 to 10 mm RMS (50 % less, 95 % interval 40 to 60)" in shrinks
    assert "on kinds of excitation that no fit had seen" in shrinks


def test_an_effect_that_the_robot_lacks_and_one_with_another_value_are_told_so():
    nominal = Model()
    effects = {n: dict(p) for n, p in nominal.effects.items() if n != GONE.name}
    effects |= {"pressure.dead_time": {"delay": 0.0612}, "rail.delay": {"delay": 0.05}}
    case = replace(CASES["incomplete"], patched=nominal.model_copy(update={"effects": effects}))
    what, sure, _ = report.answer(case)
    assert "The simulator lacks pressure.dead_time (delay 61 ms)" in what
    assert "the simulator has rail.delay (delay 50 ms) with other values than the robot" in what
    assert "the simulator has observation.finite_difference, and the robot does not" in what
    assert "more of the gap could be explained" in what
    assert "80 % to 94 %" in sure


def test_a_set_is_told_as_a_set_and_no_single_member_of_it_as_the_cause():
    what, _, _ = report.answer(CASES["set"])
    assert what == "The simulator lacks one of pressure.dead_time or pressure.lag (this recording cannot tell which)."


def test_a_headline_names_four_and_counts_more():
    many = tuple(DEAD_TIME.model_copy(update={"name": f"joint{i % 6}.effect{i}"}) for i in range(26))
    assert headline(diagnosis(verdict=verdict(effects=many))) == "26 effects in 6 stages"
    assert headline(diagnosis(verdict=verdict(effects=many[:4]))).endswith("joint2.effect2 and joint3.effect3")
    assert headline(diagnosis(verdict=verdict(effects=many[::6]))) == "5 effects in joint0"
    alike = DEAD_TIME.model_copy(update={"equivalents": tuple(e.name for e in many)})
    assert headline(diagnosis(verdict=verdict(effects=(alike,)))) == "One of 27 effects in pressure"
    wide = DEAD_TIME.model_copy(update={"equivalents": ("pressure.lag", "pressure.deadband")})
    assert headline(diagnosis(verdict=verdict(effects=(wide, wide)))) == (
        "2 effects in pressure, each of them one of a set"
    )
    pair = DEAD_TIME.model_copy(update={"equivalents": ("pressure.lag",)})
    assert headline(diagnosis(verdict=verdict(effects=(pair, OTHER_DELAY)))) == (
        "one of pressure.dead_time or pressure.lag and rail.delay"
    )


def test_many_effects_are_told_by_law_with_the_stages_that_have_them():
    many = [DEAD_TIME.model_copy(update={"name": f"servo{i}.lag"}) for i in (1, 2, 3)]
    many += [
        DEAD_TIME.model_copy(update={"name": f"servo{i}.{one}", "equivalents": (f"servo{i}.{other}",)})
        for i, one, other in ((1, "deadband", "backlash"), (2, "backlash", "deadband"))
    ]
    what, _, _ = report.answer(diagnosis(verdict=verdict(effects=tuple(many)), nominal=None, patched=None))
    assert what == (
        "The model lacks 5 effects in 3 stages: "
        "lag (servo1, servo2 and servo3), backlash or deadband (servo1 and servo2)."
    )


def test_every_shrink_stands_with_its_interval_or_says_that_there_is_none():
    told = "pressure gap, 74 % less, 95 % interval"
    assert f"{told} 70 to 78" in Page(report.render(CASES["named"])).words
    several = CASES["incomplete"]
    assert "pressure gap, 74 % less, interval not known" in Page(report.render(several)).words
    joint = replace(several, together={"pressure": interval(0.74, 0.61, 0.8), "chain": interval(0.5, 0.45, 0.55)})
    page = Page(report.render(joint)).words
    assert f"{told} 61 to 80" in page
    assert "tip, whole chain, 50 % less, 95 % interval 45 to 55" in page
    assert "interval not known" not in page


def test_a_narrow_interval_keeps_a_digit_that_tells_its_ends_apart():
    narrow = diagnosis(together={"pressure": interval(0.99, 0.9889, 0.9914)})
    assert words.less(narrow, "pressure") == "99 % less, 95 % interval 98.9 to 99.1"


def test_a_gap_that_grows_has_its_interval_the_right_way_round():
    gap = VERDICT.gap.model_copy(update={"after": rms("kPa", pressure=1.32)})
    grown = diagnosis(verdict=verdict(gap=gap), together={"pressure": interval(-0.1, -0.2, 0.05)})
    assert words.less(grown, "pressure") == "10 % more, 95 % interval -5 to 20"


def test_each_stage_has_a_paragraph_with_effects_sizes_shrink_and_what_is_left():
    told = report.paragraphs(CASES["named"])
    assert list(told) == ["pressure", "arm", "chain"]
    assert told["pressure"] == (
        "its simulator lacks pressure.dead_time (the regulator starts to react late), delay 61 ms (55 to 68). "
        "With it, its gap shrinks from 1.2 to 0.31 kPa RMS (74 % less, 95 % interval 70 to 78), on kinds of excitation "
        "that no fit had seen; what is left is 1.5 times the 0.2 kPa that count as none."
    )
    assert told["arm"] == "4 mm RMS, 1.3 times the 3 mm that count as none; no effect is named for it."
    assert "from 20 to 10 mm RMS (50 % less, 95 % interval 40 to 60)" in told["chain"]


def test_what_is_left_at_the_floor_is_nothing():
    gap = VERDICT.gap.model_copy(update={"after": rms("kPa", pressure=0.204)})
    assert (
        "0.2 kPa count as none, so nothing is left."
        in report.paragraphs(diagnosis(verdict=verdict(gap=gap)))["pressure"]
    )


def test_a_stage_within_its_floor_has_no_gap():
    assert report.paragraphs(CASES["none"]) == {"pressure": "no gap: 0.1 kPa RMS, where 0.2 kPa count as none."}


def test_a_rigs_effects_are_explained_and_sized_in_a_table_and_a_set_names_each_of_its_members():
    of_a_set = DEAD_TIME.model_copy(
        update={
            "name": "axis.deadband",
            "equivalents": ("axis.backlash",),
            "parameters": {"width": Estimate(value=0.02, low=0.01, high=0.03, unit="rad")},
        }
    )
    case = replace(CASES["own rig"], verdict=OWN_RIG.model_copy(update={"effects": (of_a_set,)}))
    page = Page(report.render(case)).words
    for name in ("axis.deadband", "axis.backlash"):
        assert AXIS[name].meaning in page
    assert "width 0.020 rad (0.010 to 0.030)" in page
    told = report.paragraphs(case)["axis"]
    assert "this recording cannot tell which; if it is axis.deadband, width 0.020 rad" in told
    assert "named, not separable" in page


def test_a_size_with_an_open_end_says_so():
    assert words.interval(interval(23.0, 20.0, 1e12), "rad/s^2") == "23 rad/s^2 (20 or more)"
    assert words.interval(interval(1e12, 20.0, 1e12), "rad/s^2") == "20 rad/s^2 or more"


def test_every_set_has_what_tells_its_members_apart_or_that_nothing_does():
    def steps(*equivalents):
        effect = DEAD_TIME.model_copy(update={"equivalents": equivalents})
        return report.steps(diagnosis(verdict=verdict(effects=(effect,))))

    assert steps("pressure.lag") == [
        "To tell apart dead_time and lag (pressure): a step: flat foot or slope at once; a multisine over a decade."
    ]
    (nothing,) = steps("mocap.scale")
    assert nothing.startswith("To tell apart mocap.scale and pressure.dead_time: nothing in the list of effects says")
    assert "dead_time and deadband: ramps of several slopes" in steps("pressure.lag", "pressure.deadband")[0]


def test_sets_of_the_same_laws_are_told_together():
    def play(i, one="deadband", other="backlash"):
        return DEAD_TIME.model_copy(update={"name": f"servo{i}.{one}", "equivalents": (f"servo{i}.{other}",)})

    vocabulary = {e.name: e for i in (1, 2, 3) for e in effects("tracking", f"servo{i}", "rad")}
    sets = (play(1), play(2, "backlash", "deadband"), play(3, "lag", "rate_limit"))
    many = verdict(effects=sets, next_experiment=None)
    first, second = report.steps(diagnosis(verdict=many, vocabulary=vocabulary, nominal=None, patched=None))
    assert first.startswith("To tell apart backlash and deadband (servo1 and servo2): reversals under load")
    assert second.startswith("To tell apart lag and rate_limit (servo3): steps of several sizes")


def test_what_separates_two_effects_is_the_same_from_either_side():
    for one, other in (("pressure.lag", "pressure.dead_time"), ("arm.stiffness", "arm.muscle_gain")):
        assert (
            following.separation(CASES["named"], one, other) == following.separation(CASES["named"], other, one) != ""
        )
    assert following.separation(CASES["own rig"], "axis.deadband", "axis.backlash").startswith("reversals under load")


def test_a_flight_is_for_the_robot_and_another_rig_is_told_what_to_record():
    pair = ("axis.deadband", "axis.lag")

    def asked(excitation, **expect):
        plan = NextExperiment(excitation=excitation, separates=pair, expect={f"axis.{k}": v for k, v in expect.items()})
        return replace(CASES["own rig"], verdict=OWN_RIG.model_copy(update={"next_experiment": plan}))

    case = asked("slow ramps", lag="a slope", deadband="a step")
    assert report.flight(CASES["named"]).name == "free-decay"
    assert report.flight(case) is None
    assert report.steps(case) == ["To tell apart axis.deadband and axis.lag, record this: slow ramps."]
    page = Page(report.render(case)).words
    assert "softarm excite" not in page
    assert "a slope" in page
    (alike,) = report.steps(asked("slow ramps", lag="a slope or none", deadband="a slope or none"))
    assert alike == "To tell apart axis.deadband and axis.lag, record this: slow ramps (a slope or none)."
    assert report.steps(asked("nothing in the list separates these")) == [
        "axis.deadband and axis.lag: nothing in the list separates these."
    ]


def test_an_unknown_cause_of_a_rig_asks_for_the_worst_recording_again():
    lone = verdict(verdict="unknown", effects=(), next_experiment=None)
    (step,) = report.steps(diagnosis(verdict=lone, nominal=None, patched=None))
    assert step.startswith("Record ")
    assert "nothing shows the gap of pressure better" in step


def test_none_beside_a_gap_above_its_floor_does_not_claim_that_all_is_well():
    gap = Gap(before=rms("s", clock=0.0067), after={}, floor=rms("s", clock=0.0012), ceiling={})
    what, sure, then = report.answer(replace(CASES["none"], verdict=NOTHING.model_copy(update={"gap": gap})))
    assert what == "No cause of a gap between robot and simulator was found on this data."
    assert "6.7 ms RMS, where 1.2 ms count as none" in sure
    assert "not proof that nothing is there" in sure
    assert "agree" not in what + sure + then
    assert headline(replace(CASES["none"], verdict=NOTHING.model_copy(update={"gap": gap}))) == "No cause found"


def test_without_a_measured_confidence_no_figure_stands_in_for_it():
    bare = DEAD_TIME.model_copy(update={"confidence": None})
    case = diagnosis(verdict=verdict(effects=(bare,)))
    _, sure, _ = report.answer(case)
    assert sure.startswith("How often such an answer is right has not been measured")
    page = Page(report.render(case)).words
    assert "Confidence is how often" not in page
    assert "94 %" not in page


@pytest.mark.parametrize(
    ("held_out", "says", "does_not"),
    [
        ("kind", "on the kinds of excitation that the fit has not seen", "stretches of"),
        ("trial", "there is no kind of excitation that it has not seen", "stretches of"),
        ("block", "how it does on new motions is not measured", "kinds of excitation that"),
        (None, "on data that the fit has not seen", "excitation"),
    ],
)
def test_the_method_says_what_was_held_out_in_this_run(held_out, says, does_not):
    page = Page(report.render(diagnosis(held_out=held_out))).words
    told = page[page.rindex("Method") :]
    assert says in told
    assert does_not not in told


def test_the_method_says_nothing_of_what_was_not_done():
    told = Page(report.render(CASES["none"])).words
    told = told[told.rindex("Method") :]
    for absent in ("jackknife", "Confidence", "flexible model", "drawn anew"):
        assert absent not in told


def test_an_unknown_cause_names_no_effect_as_the_cause():
    what, sure, then = report.answer(CASES["unknown"])
    assert "none of the known effects explains it" in what
    assert "some model could take away 75 % of it" in sure
    assert (
        "comes closest, pressure.dead_time with pressure.lag, takes away 76 %: as much, and still it did not stand"
        in sure
    )
    assert "nothing is changed" in then


def test_an_unknown_cause_beside_which_the_known_ones_do_little_says_how_little():
    weak = (Rival(("pressure.lag",), 0.1, None, {}),)
    _, sure, _ = report.answer(diagnosis(verdict=verdict(verdict="unknown", effects=()), rivals=weak))
    assert sure.endswith("comes closest, pressure.lag, takes away 10 %.")


def test_each_overlay_is_on_the_page_and_one_of_the_blamed_stage_comes_first():
    case = CASES["named"]
    data = json.loads(Page(report.render(case)).data)
    assert data["choices"] == ["stage", "trial", "channel"]
    assert data["first"] == 1
    for item, overlay in zip(data["items"], case.overlays, strict=True):
        assert item["chosen"] == [overlay.stage, NASTY, overlay.channel]
        assert list(item["curves"]) == ["measured", "nominal", "patched"][: 2 if overlay.patched is None else 3]
    assert [item["band"] for item in data["items"]] == [0.003, 0.2]


def drawn(stage, trial, swing, gap, samples=400):
    t = np.arange(samples) / 100
    measured = swing * np.sin(t)
    return Overlay(
        stage, trial, "seed", stage, {"arm": "m", "pressure": "kPa"}[stage], t, measured, measured - gap, None
    )


def test_the_picture_that_shows_first_is_the_largest_gap_against_its_floor():
    shown = (
        drawn("arm", "a", 0.1, 0.02),  # seven floors, and not the blamed stage
        drawn("pressure", "quiet", 0.1, 0.3),  # thrice its own swing
        drawn("pressure", "worst", 10.0, 0.9),
        drawn("pressure", "calm", 20.0, 0.1),
    )
    assert overlays.first(diagnosis(overlays=shown)) == 2


def test_where_nothing_is_wrong_the_liveliest_signal_shows_first_and_no_noise():
    gap = Gap(before={}, after={}, floor=rms("kPa", pressure=0.2) | rms("m", arm=0.003), ceiling={})
    shown = (
        drawn("pressure", "noise", 0.01, 0.1),
        drawn("arm", "calm", 0.01, 0.001),
        drawn("arm", "swing", 0.3, 0.001),
    )
    case = replace(CASES["none"], verdict=NOTHING.model_copy(update={"gap": gap}), overlays=shown)
    assert overlays.first(case) == 2


def test_a_long_trial_opens_where_its_gap_is_and_a_short_one_whole():
    gap = np.where(np.abs(np.arange(6000) - 4500) < 100, 1.0, 0.001)
    start, end = overlays.window(drawn("pressure", "long", 1.0, gap, 6000))
    assert start <= 44.01
    assert 45.99 <= end <= start + 6.0
    assert overlays.window(drawn("pressure", "short", 1.0, 0.1)) is None


def test_a_large_recording_is_thinned_and_the_page_says_so(monkeypatch):
    monkeypatch.setattr(plot, "BUDGET", 700)
    page = Page(report.render(CASES["named"]))
    assert json.loads(page.data)["items"][0]["t"]["n"] == 134
    assert "one of 3 samples is drawn" in page.words


def test_a_stage_without_a_residual_has_no_spectrum():
    silent = Spectrum("arm", "m", np.linspace(0.1, 50, 5000), np.zeros(5000), None, 0.0)
    assert "No spectra were computed" in Page(report.render(diagnosis(spectra=(silent,), regimes=()))).words


def test_every_part_of_the_evidence_is_on_the_page():
    page = Page(report.render(CASES["named"])).words
    for piece in (
        "softarm excite --plan verdict.json",
        "faster at first",
        "the arm bent, let go",
        "inflating",
        "1 200",
        "pressure.lag",
        "inflate 0.2 s",
        "2 % (",
        "sign of the rate",
        "arm.stiffness.scale",
        "absent 0.0612 s",
        "on the robot 60 %",
        "in the nominal simulator 90 %",
        "took 12 s",
    ):
        assert piece.replace("2 % (", "1 % (-2 to 3)") in page
    assert "in the patched simulator" not in page  # its success is not known


def test_what_could_not_be_computed_is_said_to_be_not_known():
    nan = float("nan")
    case = diagnosis(
        rivals=(Rival(("arm.drag",), nan, None, {"arm.drag.coefficient": nan}),),
        regimes=(Regime("arm", "at rest", 0, nan, None, "m"),),
        leftovers=(Leftover("arm", nan, (("rate", nan),)),),
        spectra=(Spectrum("arm", "m", np.array([0.0, 1.0]), np.array([nan, nan]), None, nan),),
    )
    text = report.render(case)
    assert "nan" not in re.sub(r"(?s)<script.*", "", text).lower()
    assert Page(text).words.count("not known") == 5


def test_a_story_is_told_with_its_title_escaped_and_its_markup_kept(tmp_path):
    path = tmp_path / "report.html"
    report.write(CASES["named"], path, story=[("Policy <now>", "<p>it <em>swings</em></p>")])
    text = path.read_text(encoding="utf-8")
    assert "<h2>Policy &lt;now&gt;</h2><p>it <em>swings</em></p>" in text
    Page(text)


def test_an_interval_has_the_digits_that_it_deserves():
    assert words.interval(interval(0.0612, 0.0551, 0.0683), "s") == "61 ms (55 to 68)"
    assert words.interval(interval(2.0, 1.96, 2.04), "N") == "2.00 N (1.96 to 2.04)"
    assert words.interval(interval(2.0, 2.0, 2.0), "N") == "2 N (2 to 2)"
