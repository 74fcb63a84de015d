"""Page of a diagnosis: its texts, its drawings, and that it loads nothing."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import pytest

from softarm.diagnosis import report
from softarm.diagnosis.report.answer import headline
from softarm.schemas.verdict import Where
from tests.diagnosis.report.cases import (
    AXIS,
    CASES,
    DEAD_TIME,
    NASTY,
    OTHER_DELAY,
    OWN_RIG,
    PAYLOAD,
    alike,
    diagnosis,
    named,
    verdict,
)
from tests.diagnosis.verdicts import effect, interval

VOID = {"meta", "br", "input"}


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


def test_every_shrink_has_its_interval_or_states_that_it_is_unknown():
    shrink = "pressure gap, 74 % less, 95 % interval"
    assert f"{shrink} 70 to 78" in Page(report.render(CASES["named"])).words
    several = replace(CASES["incomplete"], total_shrink={})
    assert "pressure gap, 74 % less, interval not known" in Page(report.render(several)).words
    joint = replace(several, total_shrink={"pressure": interval(0.74, 0.61, 0.8), "chain": interval(0.5, 0.45, 0.55)})
    page = Page(report.render(joint)).words
    assert f"{shrink} 61 to 80" in page
    assert "tip, whole chain, 50 % less, 95 % interval 45 to 55" in page
    assert "interval not known" not in page


def test_a_gap_without_an_own_interval_does_not_get_that_of_an_effect_elsewhere():
    case = replace(CASES["named"], total_shrink={})
    assert "tip, whole chain, 50 % less, interval not known" in Page(report.render(case)).words


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
    assert f">{long[:10]}…<" in page
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


def test_trials_of_one_name_are_chosen_apart():
    """Campaigns are diagnosed together, and each has a trial `seed`."""
    arm, pressure = CASES["named"].overlays
    data = json.loads(Page(report.render(diagnosis(overlays=(arm, pressure, pressure)))).data)
    assert [item["chosen"][1] for item in data["items"]] == [NASTY, NASTY, f"{NASTY} (2)"]


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
