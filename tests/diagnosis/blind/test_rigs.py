"""Answers on other people's rigs: what each is worth, and that nothing of the truth is handed over."""

import json

import pytest

from softarm.diagnosis.blind import rigs, rigs_score
from softarm.reality.rigs.case import case_of
from softarm.reality.rigs.record import write


def cause(names, tied=(), must=(), near=(), also=(), fault="x"):
    return {"fault": fault, "settings": {}, "names": names, "tied": tied, "must": must, "near": near, "also": also}


def truth(*causes, category="single", clarity=20.0):
    return {"case": "rig-1", "rig": "servo", "kind": "tracking", "category": category, "clarity": clarity,
            "causes": list(causes)}  # fmt: skip


def said(verdict, *groups, confidence=0.99):
    effects = [
        {"name": f"servo.{first}", "equivalents": [f"servo.{n}" for n in rest], "confidence": confidence}
        for first, *rest in groups
    ]
    return {"verdict": {"verdict": verdict, "effects": effects}, "failure": "", "seconds": 3.0}


LATE = cause(["dead_time"], ["latency"])
LAG = cause(["lag"])
TIE = cause(["dead_time", "lag"], ["latency"], must=["dead_time", "lag"])
OUTSIDE = cause([], near=["backlash"])


@pytest.mark.parametrize(
    ("causes", "answer", "outcome"),
    [
        ([LATE], said("named", ["dead_time"]), "right"),
        ([LATE], said("incomplete", ["dead_time", "latency"]), "right"),
        ([LATE], said("named", ["dead_time2"]), "right"),
        ([LATE], said("named", ["dead_time", "lag"]), "wide"),
        ([LATE], said("named", ["latency"]), "picked"),
        ([LATE], said("named", ["lag"]), "wrong"),
        ([LATE], said("named", ["dead_time"], ["gain"]), "wrong"),
        ([LATE], said("named", ["dead_time"], ["dead_time"]), "wrong"),
        ([LATE], said("unknown"), "silent"),
        ([LATE], said("none"), "missed"),
        ([LATE, LAG], said("named", ["lag"], ["dead_time"]), "right"),
        ([LATE, LAG], said("named", ["lag"]), "part"),
        ([LATE, LAG], said("named", ["lag"], ["gain"]), "wrong"),
        ([LATE, LAG], said("named", ["lag", "rate_limit"], ["dead_time"]), "wide"),
        ([TIE], said("named", ["lag", "dead_time"]), "right"),
        ([TIE], said("named", ["lag", "dead_time", "latency"]), "right"),
        ([TIE], said("named", ["lag"]), "picked"),
        ([TIE], said("named", ["lag", "dead_time", "gain"]), "wide"),
        ([TIE], said("named", ["lag"], ["dead_time"]), "wrong"),
        ([cause(["friction_asymmetry"], also=["coulomb_friction"])],
         said("named", ["friction_asymmetry"], ["coulomb_friction"]), "right"),
        ([OUTSIDE], said("unknown"), "right"),
        ([OUTSIDE], said("none"), "missed"),
        ([OUTSIDE], said("incomplete", ["backlash"]), "right"),
        ([OUTSIDE], said("named", ["backlash"]), "wrong"),
        ([OUTSIDE], said("incomplete", ["backlash"], ["lag"]), "wrong"),
        ([], said("none"), "right"),
        ([], said("unknown"), "silent"),
        ([], said("named", ["lag"]), "wrong"),
        ([LATE], {"verdict": None, "failure": "TrialError: no", "seconds": 1.0}, "failed"),
    ],
)  # fmt: skip
def test_an_answer_is_worth(causes, answer, outcome):
    assert rigs_score.score(truth(*causes), answer).outcome == outcome


def test_a_wrong_name_is_sure_by_its_confidence_and_a_weak_fault_has_a_row_of_its_own():
    assert rigs_score.score(truth(LATE), said("named", ["lag"])).sure
    assert rigs_score.score(truth(LATE), said("named", ["lag"], confidence=None)).sure
    assert not rigs_score.score(truth(LATE), said("named", ["lag"], confidence=0.5)).sure
    assert not rigs_score.score(truth(LATE), said("named", ["dead_time"])).sure
    assert rigs_score.score(truth(LATE, clarity=1.0), said("none")).category == rigs_score.WEAK
    assert rigs_score.score(truth(category="none", clarity=float("inf")), said("none")).category == "none"


def test_the_table_counts_every_case_once_in_each_way():
    scored = [
        rigs_score.score(truth(LATE), said("named", ["dead_time"])),
        rigs_score.score(truth(LATE), said("named", ["lag"])),
        rigs_score.score(truth(OUTSIDE, category="unknown"), said("unknown")),
    ]
    found = rigs_score.shares(scored)
    assert list(found) == ["all", "single", "unknown", "tracking"]
    assert found["all"] == found["tracking"]
    assert (found["single"]["right"], found["single"]["wrong"], found["single"]["sure"]) == (1, 1, 1)
    assert sum(found["all"][o] for o in rigs_score.OUTCOMES) == found["all"]["cases"] == 3
    assert "| single | 2 | 1 |" in rigs_score.table(found)
    assert rigs_score.listed(scored).startswith("wrong, sure: servo (single, rig-1): x; said named: lag")


def test_every_outcome_has_its_meaning():
    assert tuple(rigs_score.MEANINGS) == rigs_score.OUTCOMES


@pytest.mark.slow
def test_a_case_is_made_answered_and_scored_and_only_what_changed_is_answered_anew(tmp_path, monkeypatch, capsys):
    rigs.make([case_of("servo", ["dead_time"], seed=1, told=["steps", "chirp"])], tmp_path, 1)
    asked = []

    def answer(case):
        asked.append(case)
        assert "truths" not in {path.name for path in case.parent.iterdir()}
        return said("named", ["dead_time"])

    monkeypatch.setattr(rigs, "answer", answer)
    for _ in range(2):
        rigs.main(["run", str(tmp_path), "--processes", "1"])
    assert asked == [tmp_path / "data" / "servo-dead_time"]
    stage = asked[0] / "stage.yaml"
    stage.write_text(stage.read_text() + "\n")
    rigs.main(["run", str(tmp_path), "--processes", "1"])
    assert len(asked) == 2
    rigs.main(["score", str(tmp_path)])
    assert "| all | 1 | 1 |" in capsys.readouterr().out
    assert json.loads((tmp_path / "score.json").read_text())["cases"][0]["outcome"] == "right"


@pytest.mark.slow
def test_a_tool_that_falls_over_is_scored(tmp_path):
    write(case_of("servo", [], seed=1, told=["steps"]), tmp_path / "data", tmp_path / "truths")
    stage = tmp_path / "data" / "servo-sound" / "stage.yaml"
    stage.write_text(stage.read_text().replace("kind: tracking", "kind: flying"))
    found = rigs.answer(stage.parent)
    assert found["verdict"] is None
    assert found["failure"]


def test_a_folder_without_cases_is_told_in_a_sentence(tmp_path):
    with pytest.raises(SystemExit, match="holds no such case"):
        rigs.main(["run", str(tmp_path)])
