"""Format of verdict.json: older formats are read, newer ones are rejected."""

import json
import math

import pytest

from softarm.schemas.verdict import Estimate, Gap, Verdict, Where

NOTHING = Verdict(
    verdict="none",
    where=Where(stage=None, share={}, regime=""),
    gap=Gap(before={}, after={}, floor={}, ceiling={}),
)


def test_a_verdict_states_its_format_and_is_read_back():
    written = NOTHING.model_dump_json()
    assert json.loads(written)["format"] == 1
    assert Verdict.model_validate_json(written) == NOTHING


def test_a_verdict_without_format_has_the_first_format():
    content = NOTHING.model_dump(mode="json")
    del content["format"]
    assert Verdict.model_validate_json(json.dumps(content)) == NOTHING


def test_a_newer_format_is_refused_before_anything_else_is_checked():
    content = NOTHING.model_dump(mode="json") | {"format": 2, "unheard_of": 1}
    with pytest.raises(ValueError, match="verdict of format 2; this software reads format 1: update it"):
        Verdict.model_validate_json(json.dumps(content))


@pytest.mark.parametrize(
    ("given", "written"),
    [
        ((3.0, 2.0, math.inf), {"value": 3.0, "low": 2.0, "high": None}),
        ((math.inf, 20.0, math.inf), {"value": None, "low": 20.0, "high": None}),
        ((1.0, -math.inf, 2.0), {"value": 1.0, "low": None, "high": 2.0}),
    ],
)
def test_an_infinite_bound_is_null_in_a_verdict(given, written):
    estimate = Estimate(**dict(zip(("value", "low", "high"), given, strict=True)), unit="N")
    assert estimate.model_dump(mode="json") == json.loads(estimate.model_dump_json()) == {**written, "unit": "N"}
    assert Estimate.model_validate(written | {"unit": "N"}) == estimate
    with pytest.raises(ValueError, match="nan"):
        Estimate(value=math.nan, low=0.0, high=1.0, unit="N")
