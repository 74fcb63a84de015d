"""Calibration of confidences: bins of margins that are large enough, with chances that grow."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from softarm.diagnosis.engine import confidence
from softarm.diagnosis.engine.confidence import chance
from validation.blind import seal
from validation.confidence import BIN_LEAST, MARGINS, curves, main, of_rigs, of_robot

ANSWERS = st.lists(st.tuples(st.sampled_from(["alone", "set"]), st.floats(0, 1), st.booleans()), max_size=300)


def verdict(*sets):
    """Return a verdict that names effects, each with its equivalents."""
    return {"effects": [{"name": first, "equivalents": others} for first, *others in sets]}


@given(ANSWERS)
def test_every_answer_counts_once_and_chances_grow(answers):
    for kind, bins in curves(answers).items():
        own = [right for k, _, right in answers if k == kind]
        assert sum(each["of"] for each in bins) == len(own)
        assert sum(each["right"] for each in bins) == sum(own)
        assert [each["margin"] for each in bins] == sorted({each["margin"] for each in bins} & set(MARGINS))
        chances = [chance(each) for each in bins]
        assert chances == sorted(set(chances))
        assert len(bins) < 2 or all(each["of"] >= BIN_LEAST for each in bins)


def test_a_larger_margin_with_a_higher_share_has_its_own_bin():
    near = [("alone", 0.05, i < 15) for i in range(30)]
    far = [("alone", 0.9, True)] * 30
    assert curves(near + far)["alone"] == [
        {"margin": 0.0, "right": 15, "of": 30},
        {"margin": 0.75, "right": 30, "of": 30},
    ]


def test_a_set_with_a_cause_is_right_and_names_without_margin_do_not_count():
    labels = seal.Labels("5a" * 32, 1, {"a": {"kind": "two", "causes": [{"name": "rail.lag"}, {"name": "arm.drag"}]}})
    reply = verdict(["rail.delay", "rail.lag"], ["arm.tilt"], ["arm.drag"])
    answers = {"answers": [{"case": "a", "verdict": reply, "margins": {"rail.delay": 0.3, "arm.tilt": 0.1}}]}
    assert list(of_robot(labels, answers)) == [("set", 0.3, True), ("alone", 0.1, False)]


@pytest.mark.parametrize(("must", "right"), [([], True), (["lag", "dead_time"], False)])
def test_one_of_several_inseparable_names_is_wrong_on_its_own(tmp_path, must, right):
    cause = {"names": ["lag"], "tied": ["dead_time"], "also": [], "near": [], "must": must}
    reply = {"verdict": verdict(["servo.lag"]), "margins": {"servo.lag": 0.4}}
    for folder, content in (("truths", {"causes": [cause]}), ("answers", reply)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "a.json").write_text(json.dumps(content))
    assert list(of_rigs(tmp_path)) == [("alone", 0.4, right)]


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["rig", "nosuch"], "contains no case"),
        (["robot", "cases", "--labels", "no", "--answers", "a"], "cannot be read"),
    ],
)
def test_a_wrong_folder_leaves_the_shipped_chances_unchanged(tmp_path, monkeypatch, words, problem):
    monkeypatch.setattr(confidence, "__file__", str(tmp_path / "confidence.py"))
    with pytest.raises(SystemExit, match=f"error: .*{problem}"):
        main(words)
    assert not (tmp_path / "confidence.json").exists()
