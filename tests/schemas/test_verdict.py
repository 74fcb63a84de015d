"""Format of verdict.json: older formats are read, newer ones are rejected."""

import json

import pytest

from softarm.schemas.verdict import Gap, Verdict, Where

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
