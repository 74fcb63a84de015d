"""Benchmark of rigs: outcomes of answers, and separation of truths and data."""

import json
import operator

import pytest
from click.testing import CliRunner

from softarm.common.batch import Workers
from softarm.diagnosis.data.trials import TrialError
from validation.rigs import benchmark, sizes
from validation.rigs.case import case_of
from validation.rigs.record import write
from validation.rigs.score import WEAK, score


def cause(names, tied=(), must=(), near=(), also=()):
    return {"fault": "x", "settings": {}, "names": names, "tied": tied, "must": must, "near": near, "also": also}


def truth(*causes, category="single", clarity=20.0):
    return {"case": "rig-1", "rig": "servo", "kind": "tracking", "category": category, "clarity": clarity,
            "causes": list(causes)}  # fmt: skip


def reply(verdict, *groups, confidence=0.99):
    effects = []
    for group in groups:
        first, *rest = (f"servo.{name}" for name in group)
        effects.append({"name": first, "equivalents": rest, "confidence": confidence, "parameters": {}})
    return {"verdict": {"verdict": verdict, "effects": effects}, "failure": "", "seconds": 3.0}


LATE = cause(["dead_time"], ["latency"])
LAG = cause(["lag"])
TIE = cause(["dead_time", "lag"], ["latency"], must=["dead_time", "lag"])
OUTSIDE = cause([], near=["backlash"])


@pytest.mark.parametrize(
    ("causes", "answer", "outcome"),
    [
        ([LATE], reply("named", ["dead_time"]), "right"),
        ([LATE], reply("incomplete", ["dead_time", "latency"]), "right"),
        ([LATE], reply("named", ["dead_time2"]), "right"),
        ([LATE], reply("named", ["dead_time", "lag"]), "wide"),
        ([LATE], reply("named", ["latency"]), "picked"),
        ([LATE], reply("named", ["lag"]), "wrong"),
        ([LATE], reply("named", ["dead_time"], ["gain"]), "wrong"),
        ([LATE], reply("unknown"), "silent"),
        ([LATE], reply("none"), "missed"),
        ([LATE, LAG], reply("named", ["lag"], ["dead_time"]), "right"),
        ([LATE, LAG], reply("named", ["lag"]), "part"),
        ([LATE, LAG], reply("named", ["lag", "rate_limit"], ["dead_time"]), "wide"),
        ([TIE], reply("named", ["lag", "dead_time"]), "right"),
        ([TIE], reply("named", ["lag"]), "picked"),
        ([TIE], reply("named", ["lag"], ["dead_time"]), "wrong"),
        ([cause(["friction_asymmetry"], also=["coulomb_friction"])],
         reply("named", ["friction_asymmetry"], ["coulomb_friction"]), "right"),
        ([OUTSIDE], reply("unknown"), "right"),
        ([OUTSIDE], reply("none"), "missed"),
        ([OUTSIDE], reply("incomplete", ["backlash"]), "right"),
        ([OUTSIDE], reply("named", ["backlash"]), "wrong"),
        ([OUTSIDE], reply("incomplete", ["backlash"], ["lag"]), "wrong"),
        ([], reply("none"), "right"),
        ([], reply("unknown"), "silent"),
        ([], reply("named", ["lag"]), "wrong"),
        ([LATE], {"verdict": None, "failure": "TrialError: no", "seconds": 1.0}, "failed"),
    ],
)  # fmt: skip
def test_an_answer_has_its_outcome(causes, answer, outcome):
    assert score(truth(*causes), answer).outcome == outcome


def test_wrong_names_count_as_confident_and_weak_faults_are_counted_apart():
    assert score(truth(LATE), reply("named", ["lag"])).sure
    assert score(truth(LATE), reply("named", ["lag"], confidence=None)).sure
    assert not score(truth(LATE), reply("named", ["lag"], confidence=0.5)).sure
    assert not score(truth(LATE), reply("named", ["dead_time"])).sure
    assert score(truth(LATE, clarity=1.0), reply("none")).category == WEAK
    assert score(truth(category="none", clarity=float("inf")), reply("none")).category == "none"


def invoke(*words):
    return CliRunner().invoke(benchmark.main, [str(word) for word in words])


@pytest.mark.parametrize("wrong", [["nosuch", "dead_time"], ["servo", "nosuch"], ["servo", "--excitation", "nosuch"]])
def test_an_unknown_rig_fault_or_excitation_is_refused_with_the_known_ones(tmp_path, wrong):
    done = invoke("one", tmp_path, *wrong)
    assert done.exit_code == 2
    assert "nosuch" in done.output
    assert "servo" in done.output


@pytest.mark.slow
def test_only_changed_cases_are_answered_again_and_all_are_scored(tmp_path, monkeypatch):
    benchmark.make([case_of("servo", ["dead_time"], 1.0, 1, ["steps", "chirp"])], tmp_path, write, Workers(1))
    asked = []

    def answer(case):
        asked.append(case)
        assert "truths" not in {path.name for path in case.parent.iterdir()}
        return reply("named", ["dead_time"])

    monkeypatch.setattr(benchmark, "answer", answer)
    for _ in range(2):
        invoke("run", tmp_path, "--workers", 1)
    assert asked == [tmp_path / "data" / "servo-dead_time"]
    stage = asked[0] / "stage.yaml"
    stage.write_text(stage.read_text() + "\n")
    invoke("run", tmp_path, "--workers", 1)
    assert len(asked) == 2
    with pytest.raises(TrialError, match=r"servo-dead_time.json: belongs to other cases"):
        benchmark.make([case_of("servo", ["dead_time"], 0.5, 1, ["steps", "chirp"])], tmp_path, write, Workers(1))
    assert "| all | 1 | 1 |" in invoke("score", tmp_path).output
    assert json.loads((tmp_path / "score.json").read_text())["cases"][0]["outcome"] == "right"


def test_links_that_lean_forward_are_gravity_that_leans_back():
    case = case_of("pole", ["lean"], seed=3)
    assert sizes.true_sizes(case.truth) == {"tilt.angle": -case.causes[0].settings["tilt_rad"]}


@pytest.mark.parametrize(
    ("rig", "fault", "path", "unit", "worth", "relation"),
    [
        ("servo", "dead_time", "dead_time.delay", "s", 1.0, operator.gt),
        ("servo", "lag", "lag.rise", "s", 1.0, operator.lt),
        ("servo", "offset", "gain.offset", "deg", 0.017453292519943295, operator.eq),
        ("slide", "slope", "force_offset.force", "N", 1.0, operator.eq),
        ("slide", "backlash", "backlash.gap", "mm", 1e-3, operator.eq),
        ("boom", "moment", "stiffness.scale", "-", 1.0, operator.eq),
        ("pole", "payload", "payload.mass", "kg", 1.0, operator.eq),
    ],
)
def test_a_true_size_is_compared_in_the_owners_units(rig, fault, path, unit, worth, relation):
    case = case_of(rig, [fault], seed=3)
    true = sizes.true_sizes(case.truth)[path]
    (given,) = case.causes[0].settings.values() if fault != "payload" else [case.causes[0].settings["payload_kg"]]
    assert relation(true, given)  # of a delay and a lag the fault is a part
    effect, _, name = path.partition(".")

    def answer(low, high):
        ends = {"value": low, "low": low, "high": high, "unit": unit}
        return {"verdict": {"effects": [{"name": f"{rig}.{effect}", "parameters": {name: ends}}]}}

    around = sorted((0.9 * true / worth, 1.1 * true / worth))
    assert sizes.held(case.truth, answer(*around)) == {path: True}
    assert sizes.held(case.truth, answer(*(2 * end for end in around))) == {path: False}
    assert sizes.held(case.truth, {"verdict": None}) == {}
