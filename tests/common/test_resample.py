"""One bootstrap: deterministic, of the right spread, and as sure as it says."""

import numpy as np
import pytest

from softarm.common import resample


def test_every_draw_is_of_as_many_blocks_as_there_are_and_always_the_same():
    drawn = resample.draws(12)
    assert drawn.shape == (resample.DRAWS, 12)
    assert (drawn.sum(axis=1) == 12).all()
    assert resample.draws(12) is drawn
    with pytest.raises(ValueError, match="read-only"):
        drawn[0, 0] = 1.0


def test_no_blocks_are_refused_in_words():
    with pytest.raises(ValueError, match="nothing to draw from"):
        resample.draws(0)


def test_one_block_has_an_interval_of_no_width():
    assert resample.interval(resample.draws(1) @ np.array([3.0])) == (3.0, 3.0)


def test_a_mean_is_as_uncertain_as_the_central_limit_says():
    values = np.random.default_rng(1).normal(size=400)
    low, high = resample.interval(resample.draws(400) @ values / 400)
    error = values.std() / np.sqrt(400)
    assert high - low == pytest.approx(2 * 1.96 * error, rel=0.06)
    assert low < values.mean() < high


def test_each_column_has_an_interval_of_its_own():
    values = np.random.default_rng(2).normal(size=(60, 3)) * (1.0, 10.0, 100.0)
    low, high = resample.interval(resample.draws(60) @ values)
    assert (high - low).shape == (3,)
    for k in range(3):
        alone = resample.interval(resample.draws(60) @ values[:, k])
        np.testing.assert_allclose((low[k], high[k]), alone)


def test_its_intervals_hold_the_truth_as_often_as_they_say():
    """Of 1000 means of 100 numbers: 95 %, within what chance allows (5 of 100,000 that a right interval fails here)."""
    random, inside, runs = np.random.default_rng(3), 0, 1000
    for _ in range(runs):
        low, high = resample.interval(resample.draws(100) @ random.normal(size=100) / 100)
        inside += int(low <= 0.0 <= high)
    assert 0.915 < inside / runs < 0.975
