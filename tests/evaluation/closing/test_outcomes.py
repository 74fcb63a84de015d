"""How much better one policy is than another at the same goals, how sure that is, and when the flights may end."""

import numpy as np
import pytest

from softarm.evaluation.closing.outcomes import Flights, Paired, always_valid, better, joined, settled, stops_more


def flights(reached, stops=None, size=1):
    reached = np.array(reached, dtype=bool)
    return Flights(reached, tuple(stops or [None] * len(reached)), np.arange(len(reached)) // size)


def drawn(rng, count, gain, differ=0.15):
    """Return the outcomes of two policies that differ in a share of the flights."""
    change = rng.choice([-1, 0, 1], size=count, p=[(differ - gain) / 2, 1 - differ, (differ + gain) / 2])
    both = rng.random(count) < 0.8
    return flights(np.where(change == 0, both, change < 0)), flights(np.where(change == 0, both, change > 0))


@pytest.mark.parametrize("truly", [0.0, 0.1])
def test_an_interval_that_is_looked_at_again_and_again_misses_the_truth_in_at_most_5_percent(truly):
    rng, missed = np.random.default_rng(3), 0
    for _ in range(40):
        old, new = drawn(rng, 216, truly)
        looks = (better(old.chosen(slice(n)), new.chosen(slice(n))) for n in (24, 48, 72, 108, 216))
        missed += any(not won.low <= truly <= won.high for won in looks)
    assert missed <= 2


def test_a_large_gain_settles_early_and_no_gain_before_the_end():
    rng = np.random.default_rng(1)
    old, new = drawn(rng, 324, 0.4, differ=0.5)
    ends = next(n for n in range(6, 325, 6) if settled(old.chosen(slice(n)), new.chosen(slice(n))))
    assert ends <= 72
    same = flights([True, False] * 162)
    ends = next(n for n in range(6, 325, 6) if settled(same.chosen(slice(n)), same.chosen(slice(n))))
    assert 36 < ends < 162
    worse = settled(new.chosen(slice(72)), old.chosen(slice(72)))
    assert worse


def test_the_interval_holds_the_mean_and_narrows():
    widths = []
    for count in (30, 120, 480):
        low, high = always_valid(np.tile([1.0, 0.0, 0.0], count // 3))
        assert low < 1 / 3 < high
        widths.append(high - low)
    assert widths == sorted(widths, reverse=True)
    assert always_valid(np.zeros(0)) == (-1.0, 1.0)
    assert flights([True, False] * 60).interval == pytest.approx((0.5, 0.5), abs=0.15)


def test_flights_of_a_group_count_once():
    old, new = [False] * 120, [True] * 40 + [False] * 80
    alone, together = (better(flights(old, size=size), flights(new, size=size)) for size in (1, 10))
    assert alone.value == pytest.approx(together.value) == pytest.approx(1 / 3)
    assert alone.above
    assert not together.above  # four of twelve groups


def test_stops_are_counted_separately_and_settle():
    why = "rail_disagrees: the axis and motion capture disagree"
    old, new = flights([True] * 60), flights([True, False] * 30, [None, why] * 30)
    assert stops_more(old, new).value == 0.5
    assert stops_more(old, new).above
    assert settled(old, new)
    assert not stops_more(new, old).above


def test_joined_flights_keep_distinct_groups():
    whole = joined([flights([True] * 6, size=3), flights([False] * 4, size=2)])
    assert whole.group.tolist() == [0, 0, 0, 1, 1, 1, 2, 2, 3, 3]
    assert whole.share == 0.6
    assert whole.chosen(whole.group == 1).reached.tolist() == [True] * 3
    assert joined(()).reached.size == 0


def test_a_difference_is_written_in_percent():
    assert better(flights([True, False] * 60), flights([True, True] * 60)).text.startswith("+50.0 % (+")
    assert Paired(-0.0001, -0.05, 0.0).text == "0 % (-5.0 to 0)"
