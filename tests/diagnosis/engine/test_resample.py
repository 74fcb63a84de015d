"""One bootstrap: deterministic, of the right spread, and as sure as it says."""

import numpy as np
import pytest

from softarm.diagnosis.engine import resample


def test_every_draw_has_all_blocks_and_is_reproducible():
    drawn = resample.draws(12)
    assert drawn.shape == (resample.DRAWS, 12)
    assert (drawn.sum(axis=1) == 12).all()
    assert resample.draws(12) is drawn
    with pytest.raises(ValueError, match="read-only"):
        drawn[0, 0] = 1.0


def test_one_block_has_an_interval_of_no_width():
    assert resample.interval(resample.draws(1) @ np.array([3.0])) == (3.0, 3.0)


def test_the_interval_of_a_mean_matches_the_central_limit():
    values = np.random.default_rng(1).normal(size=400)
    low, high = resample.interval(resample.draws(400) @ values / 400)
    error = values.std() / np.sqrt(400)
    assert high - low == pytest.approx(2 * 1.96 * error, rel=0.06)
    assert low < values.mean() < high
