"""Recommendation: the retrained policy must be better on the patched model, and worse nowhere on the robot."""

from dataclasses import replace

import numpy as np
import pytest

from softarm.diagnosis.engine.result import Diagnosis
from softarm.evaluation.closing import story
from softarm.evaluation.closing.closed import Closed, Place, advise
from softarm.evaluation.closing.outcomes import (
    ADAPTIVE,
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
from softarm.schemas.model import Model
from softarm.training.run.retrain import Retrained
from tests.evaluation.closing import cases

RAIL = cases.findings(Config())
PLACES = tuple(Place(key, f"the {key} one", Model()) for key in (NOMINAL, PATCHED, HELD_OUT))
SPENT = {step: {"wall_s": 10.0, "cpu_s": 15.0} for step in ("diagnose", "retrain", OLD, REPLANNED, NEW, ADAPTIVE)}
WHY = "rail_outside: the cart is outside the rail limits"


def reached(count, stops=0, flights=120):
    """Return flights of which the first `count` reached and the last `stops` were stopped."""
    hits = np.arange(flights) < count
    stopped = tuple(WHY if number >= flights - stops else None for number in range(flights))
    return Flights(hits, stopped, np.arange(flights))


def closed(ways, declared=True, better=True, wires=None):
    """Return results from policy -> number of 120 flights that reached on the judging robot."""
    judged = PLACES[2 if declared else 1]
    flown = {(OLD, NOMINAL): reached(100), (OLD, PATCHED): reached(82), (OLD, judged.key): reached(80)}
    flown |= {(name, judged.key): n if isinstance(n, Flights) else reached(n) for name, n in ways.items()}
    retrained = Retrained(MODELS / "reach.onnx", 1, 1.0, 0.82, 0.91 if better else 0.82, ())
    found = Diagnosis(cases.named("rail.delay", 0.05, 0.06), Model(), Model(), ())
    return Closed(found, MODELS / "reach.onnx", PLACES, judged, flown, retrained, RAIL, SPENT, wires)


def test_the_way_with_the_largest_proven_gain_is_recommended():
    found = closed({REPLANNED: 110, NEW: 105, ADAPTIVE: 78})
    advice = advise(found)
    assert advice.fly == REPLANNED
    assert advice.against[NEW] == ()
    assert "the held-back one it is no better: -1.7 % (" in advice.against[ADAPTIVE][0]
    assert story.sentences(found)[0] == "Fly the policy mppi on patched-model.yaml."
    assert advise(closed({NEW: 105})).fly == NEW


@pytest.mark.parametrize(
    ("new", "says"),
    [
        (79, "on the held-back one it is no better: -0.8 % ("),
        (40, "on the held-back one it is worse: -33.3 % ("),
        (83, "on the held-back one it is not significantly better: +2.5 % (-"),
        (reached(105, stops=15), "on the held-back one it causes more unrequested stops: 15, not 0"),
    ],
)
def test_one_reason_against_keeps_the_old_policy(new, says):
    found = closed({NEW: new})
    assert advise(found).fly == OLD
    assert len(advise(found).against[NEW]) == 1
    assert says in advise(found).against[NEW][0]
    texts = story.sentences(found)
    assert texts[0] == "Keep the old policy."
    assert texts[1].startswith("Retrained: on ")
    found = story.summary(found)
    assert found["fly"] == OLD
    assert says in found["against"][NEW][0]


def test_an_undeclared_robot_leaves_the_decision_to_the_patched_simulator():
    found = closed({NEW: 105}, declared=False)
    assert advise(found).fly == NEW
    assert "on the patched one" in advise(closed({NEW: 80}, declared=False)).against[NEW][0]
    assert found.with_task().diagnosis.verdict.task.success_real is None
    assert closed({NEW: 105}).with_task().diagnosis.verdict.task.success_real == 80 / 120


def test_a_comparison_that_ended_early_uses_the_same_draws_of_the_old_policy():
    found = closed({REPLANNED: reached(36, flights=36)})
    assert found.won(REPLANNED).value == 0.0
    assert [row[3] for row in story.lines(found)[1]] == ["120", "36"]


def test_a_validation_without_gain_keeps_the_old_policy():
    against = advise(closed({NEW: 105}, better=False)).against[NEW]
    assert against == ("in validation it is no better: 82 % before, 82 % after",)


def through(old, new, **changed):
    flown = {(name, manner): each for name, each in ((OLD, old), (NEW, new)) for manner in MANNERS}
    return Wires(**{"title": "the robot", "is_the_robot": True, "flown": flown, "log": "a.mcap"} | changed)


def test_flights_on_the_wires_of_the_robot_count():
    worse = through(reached(110), reached(50))
    assert "on the robot it is worse" in advise(closed({NEW: 105}, wires=worse)).against[NEW][0]
    assert advise(closed({NEW: 105}, wires=replace(worse, is_the_robot=False))).fly == NEW
    stopped = through(reached(80), reached(100), ended=WHY, ended_by=NEW)
    assert f"it caused an unrequested stop: {WHY}" in advise(closed({NEW: 105}, wires=stopped)).against[NEW][0]
    assert advise(closed({NEW: 105}, wires=replace(stopped, ended_by=None))).fly == NEW
    texts = " ".join(story.sentences(closed({NEW: 105}, wires=stopped)))
    assert "On the wires of the robot: the old policy reaches 67 % of 240 goals, the retrained one 83 %" in texts
    assert "the flights ended early: rail_outside" in texts


def test_a_gain_on_the_wires_suffices_without_a_loss_elsewhere():
    wires = through(reached(60), reached(110))
    assert advise(closed({NEW: 81}, wires=wires)).fly == NEW
    assert advise(closed({NEW: 79}, wires=wires)).fly == OLD
    assert advise(closed({NEW: 81}, wires=replace(wires, is_the_robot=False))).fly == OLD


def test_missing_flights_on_wires_are_stated_and_do_not_count():
    still = Wires.unflown("the robot of softarm.yaml", "not wanted")
    found = closed({NEW: 105}, wires=still)
    assert advise(found).fly == NEW
    assert "No flight on the wires of the robot of softarm.yaml: not wanted." in story.sentences(found)
    assert story.summary(found)["wires"]["ended"] == "not wanted"
    titles = dict(story.sections(found))
    assert "No flight" in titles["Flights on wires"]
    assert "<table" not in titles["Flights on wires"]


def test_the_table_has_a_row_per_way_with_its_time():
    found = closed({REPLANNED: 110, NEW: reached(105, stops=1), ADAPTIVE: 78})
    head, rows = story.lines(found)
    assert [row[0] for row in rows] == ["old policy", "mppi on the patch", "retrained", "adaptive policy"]
    assert rows[2][head.index("stops")] == "1"
    # The diagnosis is part of what a way takes, except for a policy that needs none.
    assert [row[head.index("processor")] for row in rows] == ["0 s", "30 s", "45 s", "15 s"]
    assert rows[1][head.index("gain, 95 %")] == found.won(REPLANNED).text
    assert story.sentence(found, REPLANNED).startswith("Mppi on the patch: 92 % of 120 flights on the held-back one")
    page = dict(story.sections(found))["The ways to fly"]
    assert "always valid" in page
    assert page.count("<svg") == 4
    ways = story.summary(found)["ways"]
    assert sum(ways[NEW][manner]["reached"] for manner in MANNERS) == 105
