"""Share with its confidence interval."""

import pytest

from softarm.common.shares import share


def test_a_share_has_a_wilson_interval():
    found = share([True] * 8 + [False] * 2)
    assert (found["share"], found["hits"], found["of"]) == (0.8, 8, 10)
    assert (found["low"], found["high"]) == pytest.approx((0.4902, 0.9433), abs=1e-4)  # Newcombe 1998's method 3
    assert share([])["share"] is None
