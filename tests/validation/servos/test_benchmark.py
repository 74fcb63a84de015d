"""Benchmark of servos that another program simulates: outcomes and messages; that program is not needed."""

import json

import pytest

from softarm.diagnosis.data.trials import TrialError
from validation.blind import seal
from validation.servos import benchmark


def verdict(word, *groups):
    return {"verdict": word, "effects": [{"name": f"servo.{a}", "equivalents": b} for a, *b in groups]}


@pytest.mark.parametrize(
    ("law", "found", "expected"),
    [
        ("m1", verdict("none"), "right"),
        ("m1", verdict("unknown"), "silent"),
        ("m1", verdict("named", ["damping"]), "wrong"),
        ("m2", verdict("named", ["coulomb_friction"]), "right"),
        ("m3", verdict("named", ["drag", "servo.load_friction"]), "right"),
        ("m3", verdict("named", ["load_friction"], ["stiction"]), "more"),
        ("m4", verdict("incomplete", ["load_friction"], ["stiction"]), "right"),
        ("m4", verdict("named", ["stiction"]), "wrong"),
        ("m6", verdict("none"), "silent"),
    ],
)
def test_the_outcome_compares_names_with_the_friction_that_was_simulated(law, found, expected):
    assert benchmark.outcome({"law": law}, found) == expected


def test_a_python_without_bam_is_refused_with_a_remedy(tmp_path):
    with pytest.raises(TrialError, match=r"cannot run recorder.py .*give a Python 3.12 with better-actuator-models"):
        benchmark.make(tmp_path, tmp_path / "no-such-python")


def test_a_score_holds_every_case_also_one_that_failed(tmp_path):
    replies = {"a-m1": verdict("none"), "b-m2": None}
    for case, found in replies.items():
        for folder, content in (
            ("truths", {"case": case, "law": case[-2:]}),
            ("answers", {"verdict": found, "seconds": 1.0, "tool": seal.tool_version()}),
            ("compared", {"tool": "of the kept file", **{model: {"rms_rad": 0.1} for model in benchmark.MODELS}}),
        ):
            (tmp_path / folder).mkdir(exist_ok=True)
            (tmp_path / folder / f"{case}.json").write_text(json.dumps(content))
    found = benchmark.score(tmp_path)
    assert {law: counts for law, counts in found["outcomes"].items() if counts} == {
        "m1": {"right": 1},
        "m2": {"failed": 1},
    }
    assert [list(each) for each in found["held_out"].values()] == [list(benchmark.MODELS)] * 2
    (tmp_path / "answers" / "a-m1.json").write_text(json.dumps({"verdict": None, "seconds": 1.0, "tool": "older"}))
    with pytest.raises(TrialError, match="contains answers of another version; use `run` again"):
        benchmark.score(tmp_path)
