"""How far a gap shrinks: the share, its interval, and what another excitation may make of it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softarm.diagnosis.engine.shrink import REST_LEAST, REST_MOST, chain_interval, interval, with_rest

SQUARES = st.lists(st.tuples(st.floats(0.1, 100), st.floats(0.0, 1.0)), min_size=2, max_size=12)


@given(SQUARES)
def test_an_interval_holds_its_own_value_and_ends_at_one(trials):
    before, share = np.array(trials).T
    for law in (interval, chain_interval):
        value, low, high = law(before, before * share)
        assert low < value <= high <= 1


@given(st.floats(0.01, 0.99), st.floats(0.1, 20), st.floats(0.1, 20))
def test_the_explained_part_stays_while_the_rest_grows(shrink, times, more):
    other = with_rest(shrink, times)
    rest, new = (1 - shrink) ** 2, (1 - other) ** 2
    assert new / (1 - new) == pytest.approx(times * rest / (1 - rest), rel=1e-6)
    assert with_rest(other, more) == pytest.approx(with_rest(shrink, times * more), abs=1e-9)


def test_the_tip_s_interval_holds_where_lively_flights_leave_more():
    before = np.full(8, 1.0)
    value, low, high = chain_interval(before, before * 0.02)
    assert value == pytest.approx(1 - np.sqrt(0.02))
    assert low == pytest.approx(with_rest(value, REST_MOST))
    assert high == pytest.approx(with_rest(value, REST_LEAST))


def test_a_gap_that_did_not_shrink_keeps_its_bootstrap_interval():
    assert with_rest(-0.2, 9.0) == -0.2
    assert with_rest(1.0, 9.0) == 1.0


def test_a_single_part_of_the_data_has_no_interval():
    with pytest.raises(ValueError, match="1 part of the data"):
        interval(np.ones(1), np.zeros(1))
