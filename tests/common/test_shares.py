"""Shares with their intervals."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from softarm.common.shares import share


@given(st.lists(st.booleans(), min_size=1, max_size=300))
def test_an_interval_holds_its_share(hits):
    found = share(hits)
    assert 0 <= found["low"] <= found["share"] <= found["high"] <= 1


def test_an_interval_of_hits_alone_ends_at_one():
    """Rounding ended it at 0.9999999999999998 for 127 of 127, and a plot refused the error bar."""
    assert all(share([True] * count)["high"] == 1 for count in range(1, 300))
    assert all(share([False] * count)["low"] == 0 for count in range(1, 300))


def test_a_share_has_a_wilson_interval():
    found = share([True] * 8 + [False] * 2)
    assert (found["share"], found["hits"], found["of"]) == (0.8, 8, 10)
    assert (found["low"], found["high"]) == pytest.approx((0.4902, 0.9433), abs=1e-4)  # Newcombe 1998's method 3
    assert share([])["share"] is None
