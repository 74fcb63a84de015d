"""Recommendation: the retrained policy must be better on the patched model, and worse nowhere on the robot."""

from dataclasses import replace

import numpy as np
import pytest

from softarm.diagnosis.engine.result import Diagnosis
from softarm.evaluation.closing import story, summary
from softarm.evaluation.closing.advice import advise
from softarm.evaluation.closing.closed import Closed, Place
from softarm.evaluation.closing.outcomes import (
    CHAINED,
    HELD_OUT,
    MANNERS,
    NEW,
    NOMINAL,
    OLD,
    PATCHED,
    REPLANNED,
    Flights,
)
from softarm.evaluation.closing.wires import Wires
from softarm.policies.base import MODELS
from softarm.schemas.config import Config
from softarm.schemas.flights import TEST_TARGETS
from softarm.schemas.model import Model
from softarm.training.run.retrain import Retrained
from tests.evaluation.closing import cases

RAIL = cases.findings(Config())
PLACES = tuple(Place(key, f"the {key} one", Model()) for key in (NOMINAL, PATCHED, HELD_OUT))
WHY = "rail_outside: the cart is outside the rail limits"


def reached(count, stops=0):
    """Return 162 flights of which the first `count` reached and the last `stops` were stopped."""
    hits = np.arange(162) < count
    return Flights(hits, tuple(WHY if number >= 162 - stops else None for number in range(162)), np.arange(162) // 3)


def closed(shares, declared=True, better=True, wires=None, replanned=None):
    """Return results from place -> (old, new) numbers of 162 flights that reached, from rest and chained alike."""
    flown = {}
    for key, pair in shares.items():
        for manner in MANNERS:
            for name, each in zip((OLD, NEW), pair, strict=True):
                flown[name, key, manner] = each if isinstance(each, Flights) else reached(each)
            if replanned is not None and key != NOMINAL:
                flown[REPLANNED, key, manner] = reached(replanned)
    retrained = Retrained(MODELS / "reach.onnx", 1, 1.0, 0.82, 0.91 if better else 0.82, ())
    found = Diagnosis(cases.named("rail.delay", 0.05, 0.06), Model(), Model(), ())
    return Closed(found, MODELS / "reach.onnx", PLACES, flown, retrained, TEST_TARGETS, RAIL, declared, wires)


WON = {NOMINAL: (140, 130), PATCHED: (120, 145), HELD_OUT: (120, 140)}


def test_a_policy_that_is_better_everywhere_is_recommended():
    advice = advise(closed(WON))
    assert (advice.fly, advice.against) == ("retrained", ())
    assert story.sentences(closed(WON))[0] == "Fly the retrained policy."


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({PATCHED: (147, 145)}, "on the patched simulator the retrained policy is no better: -1.2 % ("),
        ({PATCHED: (147, 130)}, "on the patched simulator the retrained policy is worse: -10.5 % ("),
        ({PATCHED: (145, 146), HELD_OUT: (140, 140)}, "not significantly better: +0.6 % (0 to +"),
        ({HELD_OUT: (140, 130)}, "on the held-back one it is worse: -6.2 % ("),
        ({PATCHED: (120, reached(150, stops=12))}, "the patched one it causes more unrequested stops: 24, not 0"),
        ({HELD_OUT: (120, reached(150, stops=12))}, "the held-back one it causes more unrequested stops: 24"),
    ],
)
def test_one_reason_against_keeps_the_old_policy(changed, says):
    found = closed(WON | changed)
    assert advise(found).fly == "old"
    assert len(advise(found).against) == 1
    assert says in advise(found).against[0]
    assert story.sentences(found)[0].startswith("Keep the old policy: on ")
    texts = summary.summary(found, {})
    assert texts["fly"] == "old"
    assert texts["against_retrained"] == list(advise(found).against)


def test_a_gain_on_the_robot_itself_suffices_without_a_loss_on_the_patched_model():
    found = closed(WON | {PATCHED: (145, 146)})
    assert advise(found).fly == "retrained"
    assert advise(replace(found, declared=False)).fly == "old"
    wires = through(reached(100), reached(120))
    assert advise(replace(found, declared=False, wires=wires)).fly == "retrained"
    assert advise(replace(found, declared=False, wires=replace(wires, is_the_robot=False))).fly == "old"


def test_an_undeclared_robot_does_not_count():
    assert advise(closed(WON | {HELD_OUT: (140, 120)}, declared=False)).fly == "retrained"


def test_a_validation_without_gain_keeps_the_old_policy():
    assert advise(closed(WON, better=False)).against == ("in validation it is no better: 82 % before, 82 % after",)


def through(old, new, **changed):
    flown = {(name, manner): each for name, each in ((OLD, old), (NEW, new)) for manner in MANNERS}
    return Wires(**{"title": "the robot", "is_the_robot": True, "flown": flown, "log": "a.mcap"} | changed)


def test_flights_on_the_wires_of_the_robot_count():
    worse = through(reached(140), reached(100))
    assert "on the robot it is worse" in advise(closed(WON, wires=worse)).against[0]
    assert advise(closed(WON, wires=replace(worse, is_the_robot=False))).fly == "retrained"
    stopped = through(reached(100), reached(110), ended=WHY, ended_by=NEW)
    assert f"it caused an unrequested stop: {WHY}" in advise(closed(WON, wires=stopped)).against[0]
    assert advise(closed(WON, wires=replace(stopped, ended_by=None))).fly == "retrained"
    texts = " ".join(story.sentences(closed(WON, wires=stopped)))
    assert "On the wires of the robot: the old policy reaches 62 % of 324 goals, the retrained one 68 %" in texts
    assert "the flights ended early: rail_outside" in texts


def test_missing_flights_on_wires_are_stated_and_do_not_count():
    still = Wires.unflown("the robot of softarm.yaml", "not wanted")
    found = closed(WON, wires=still)
    assert advise(found).fly == "retrained"
    assert "No flight on the wires of the robot of softarm.yaml: not wanted." in story.sentences(found)
    assert summary.summary(found, {})["wires"]["ended"] == "not wanted"
    titles = dict(story.sections(found))
    assert "No flight" in titles["Flights on wires"]
    assert "No flight" not in titles["The policy before and after"]
    assert "<table" not in titles["Flights on wires"]


def test_mppi_is_compared_with_the_recommended_policy():
    texts = story.sentences(closed(WON, replanned=150))[-1]
    assert texts.startswith("Without training: mppi, planning on patched-model.yaml, reaches 93 % on the patched")
    assert "significantly more than the retrained policy" in texts
    assert "+6.2 %" in texts  # than the retrained one: 150 to 140 of 162
    kept = closed(WON | {PATCHED: (147, 145)}, replanned=120)
    assert "about as much as the old policy" in story.sentences(kept)[-1]  # 120 to the old one's 120
    assert summary.summary(kept, {})["mppi_beyond_advised"][HELD_OUT]["value"] == 0.0


def test_unrequested_stops_are_stated_separately():
    texts = " ".join(story.sentences(closed(WON | {HELD_OUT: (reached(120, stops=3), reached(140, stops=1))})))
    assert "Unrequested stops on the held-back one: old policy 6, retrained 2 (the first: rail_outs" in texts
    assert "No unrequested stop" in " ".join(story.sentences(closed(WON)))


def test_the_table_has_a_row_per_robot_and_start():
    head, rows = story.lines(closed(WON, replanned=150))
    assert head == ("robot", "start", "old policy", "retrained", "mppi", "retrained - old, 95 %", "unrequested stops")
    assert [row[:2] for row in rows[::2]] == [(place.title, "at rest") for place in PLACES]
    assert rows[1][1] == "in mid-swing"
    assert rows[0][4] == "-"
    assert closed(WON).changed(PATCHED, CHAINED) == {"gained": 25, "lost": 0}
