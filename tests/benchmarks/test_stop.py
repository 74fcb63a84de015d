"""A stop is answered in time while the API is under attack: a small version of the benchmark, over a real daemon."""

import pytest

from softarm.benchmarks import stop


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.timeout(170)
def test_a_stop_by_its_own_way_is_answered_under_every_attack():
    found = stop.run(5, list(stop.ATTACKS), lambda share: None)
    assert {name: ways["stop"]["unanswered"] for name, ways in found.items()} == dict.fromkeys(stop.ATTACKS, 0)
    late = {name: ways["stop"] for name, ways in found.items() if ways["stop"]["p50"] > 50}
    assert late == {}


def test_times_are_told_with_those_that_never_came():
    assert stop._spread([0.01, None, 0.03])["unanswered"] == 1
    assert stop._told(stop._spread([0.01, None, 0.03])) == "20.0 / 29.8 / 30.0, 1 of 3"
    assert stop._told(stop._spread([None])) == "none of 1"
