"""How much better one policy is than another at the same goals, and how sure that is."""

import numpy as np
import pytest

from softarm.evaluation.closing.outcomes import Flights, better, joined, stops_more


def flights(reached, stops=None, size=3):
    reached = np.array(reached, dtype=bool)
    return Flights(reached, tuple(stops or [None] * len(reached)), np.arange(len(reached)) // size)


def test_the_difference_is_of_shares_with_an_interval_around_it():
    old, new = [True, False, False] * 20, [True, True, False] * 20
    won = better(flights(old), flights(new))
    assert won.value == pytest.approx(1 / 3)
    assert (won.low, won.high) == pytest.approx((1 / 3, 1 / 3))  # every target alike: nothing that drawing could change
    assert won.above
    assert not won.below


@pytest.mark.parametrize("truly", [0.0, 0.1])
def test_the_interval_of_a_difference_covers_the_truth_in_about_95_percent(truly):
    """Targets differ in how hard they are, and a target's three flights have that in common."""
    rng, held = np.random.default_rng(3), 0
    for _ in range(400):
        hard = np.repeat(rng.choice([0.6, 0.85], 54), 3)
        old, new = rng.random(162) < hard, rng.random(162) < hard + truly
        won = better(flights(old), flights(new))
        held += won.low <= truly <= won.high
    assert 0.915 <= held / 400 <= 0.98


def test_flights_of_a_group_are_resampled_together():
    old, new = [False] * 60, [True] * 10 + [False] * 50
    alone, together = (better(flights(old, size=size), flights(new, size=size)) for size in (1, 10))
    assert alone.above
    assert not together.above  # one group of six: chance


def test_stops_are_counted_separately():
    why = "rail_disagrees: the axis and motion capture disagree"
    old, new = flights([True] * 12), flights([True, False] * 6, [None, why] * 6)
    assert stops_more(old, new).value == 0.5
    assert stops_more(old, new).above
    assert stops_more(new, old).below


def test_joined_flights_keep_distinct_groups():
    whole = joined([flights([True] * 6), flights([False] * 4, size=2)])
    assert whole.group.tolist() == [0, 0, 0, 1, 1, 1, 2, 2, 3, 3]
    assert whole.share == 0.6


def test_a_difference_is_written_in_percent():
    assert better(flights([True, False] * 30), flights([True, True] * 30)).text.startswith("+50.0 % (+")
