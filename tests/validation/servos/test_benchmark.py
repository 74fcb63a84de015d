"""Benchmark of servos that another program simulates: outcomes and messages; that program is not needed."""

import pytest

from softarm.diagnosis.data.trials import TrialError
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
