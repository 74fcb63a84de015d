"""Whitening: coloured noise comes out white and of size one, and nothing that touches a gap is counted."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from softarm.diagnosis.engine.noise import ORDER, scaled, whitener

LENGTH = 3000  # samples a trial


@pytest.fixture(scope="module")
def coloured():
    """Noise of two trials and two channels: an autoregression, sizes a thousand times apart."""
    draw = np.random.default_rng(1)
    noise = lfilter([1.0], [1.0, -1.5, 0.7], draw.normal(size=(2, LENGTH, 2)), axis=1).reshape(-1, 2)
    return noise * (1.0, 1e-3)


def _view(gap, floor=(1e-3, 1e-6)):
    """Return the part of a view that whitening needs."""
    return SimpleNamespace(measured=gap.copy(), trial=np.repeat([0, 1], len(gap) // 2), floor=np.array(floor))


def _correlation(values, lag):
    return float(np.corrcoef(values[lag:], values[:-lag])[0, 1])


def test_coloured_noise_comes_out_white_and_of_size_one(coloured):
    white = whitener(_view(coloured), coloured)(coloured)
    for s in range(2):
        assert _correlation(coloured[:, s], 1) > 0.8
        assert max(abs(_correlation(white[:, s], lag)) for lag in range(1, 8)) < 0.05
        assert np.std(white[:, s]) == pytest.approx(1.0, abs=0.05)


def test_starts_and_gaps_are_left_out_and_nothing_else(coloured):
    """A filter that saw a gap, or the trial before, says nothing."""
    gap = coloured.copy()
    gap[1000, 0] = np.nan
    whiten = whitener(_view(gap), gap)
    expected = np.ones_like(whiten.keep)
    for start in (0, LENGTH):
        expected[start : start + ORDER] = 0
    expected[1000 : 1000 + ORDER + 1, 0] = 0
    np.testing.assert_array_equal(whiten.keep, expected)
    white = whiten(gap)
    assert np.isfinite(white).all()
    np.testing.assert_array_equal(white != 0, expected == 1)


def test_a_batch_is_whitened_as_each_alone(coloured):
    whiten = whitener(_view(coloured), coloured)
    both = whiten(np.stack((coloured, -2 * coloured)))
    np.testing.assert_array_equal(both[1], whiten(-2 * coloured))


def test_a_residual_far_below_the_floor_is_not_blown_up(coloured):
    """Differences within the noise floor must not decide between models."""
    tiny = 1e-6 * coloured
    white = whitener(_view(tiny, (1.0, 1.0)), tiny)(tiny)
    assert np.abs(white).max() < 1e-3


def test_before_anything_is_known_only_sizes_count(coloured):
    view = _view(coloured, (1e-9, 1.0))
    gap = scaled(view, coloured)(coloured)
    assert np.sqrt(np.mean(gap[:, 0] ** 2)) == pytest.approx(5.0, rel=1e-4)
    np.testing.assert_allclose(gap[:, 1], coloured[:, 1], rtol=1e-4, atol=1e-9)
