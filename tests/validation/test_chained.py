"""Chained goals: a small run, and the count of excursions."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from validation import chained
from validation.chained import Cart


def test_a_cart_beyond_its_bound_counts_once_until_it_is_back():
    cart = Cart(bound_m=0.255, travel_m=0.3)
    for place in (0.0, -0.256, -0.26, 0.25, 0.256, 0.3, 0.2999, 0.2, 0.3):
        cart.look(place)
    assert (cart.excursions, cart.crashes, cart.max_m) == (3, 2, 0.3)


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
