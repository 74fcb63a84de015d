"""Chained goals: a small run, and the count of excursions."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from validation import chained


@pytest.mark.slow
@pytest.mark.parametrize(
    "body",
    ["simulated", pytest.param("outside", marks=[pytest.mark.prove, pytest.mark.realtime])],
)
def test_goals_are_flown_without_rest(body: str, tmp_path: Path):
    file = tmp_path / "chained.json"
    done = CliRunner().invoke(chained.main, ["--body", body, "--goals", "2", "--json", str(file)])
    assert file.exists(), done.output
    figures = json.loads(file.read_text())
    assert (figures["goals"], figures["crashes"], figures["excursions"]) == (2, 0, 0)
    assert figures["max_cart_m"] > 0.02
