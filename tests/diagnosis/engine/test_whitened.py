"""A whitened residual: a trial's unknown start is not held against a model, and nothing is simulated twice."""

import numpy as np
import pytest

from softarm.diagnosis.engine.noise import Whitener
from softarm.diagnosis.engine.whitened import BLOCK_S, START_PRIOR, Gaps, WhitenedResidual

RATE_HZ, SAMPLES, CHANNELS = 60.0, (300, 240), 2


class _View:
    """Two trials whose gap is a sine of the size `view.effect.size`; it counts how often it is asked."""

    acts = frozenset({"view.effect.size"})
    t_s = np.concatenate([7.0 + np.arange(n) / RATE_HZ for n in SAMPLES])
    trial = np.repeat(np.arange(len(SAMPLES)), SAMPLES)

    def __init__(self):
        self.asked = []

    def gap(self, points):
        self.asked.append(len(points))
        wave = np.stack((np.sin(5 * self.t_s), np.cos(3 * self.t_s)), axis=1)
        return np.stack([p.get("view.effect.size", 0.0) * wave for p in points]).astype(np.float32)


def _residual(gaps, starts=None, weight=1.0):
    m = sum(SAMPLES)
    whiten = Whitener(np.ones((CHANNELS, 1), np.float32), np.ones((m, CHANNELS), np.float32))
    nuisances = np.stack([np.ones((m, CHANNELS)), np.repeat([[0.0, 2.0]], m, axis=0)]).astype(np.float32)
    return WhitenedResidual(gaps, whiten, nuisances, starts, weight)


@pytest.fixture
def view():
    return _View()


@pytest.fixture(scope="module")
def starts():
    """Return the effect of a start: a decaying offset in each channel, large against a residual of one."""
    t = np.concatenate([np.arange(n) / RATE_HZ for n in SAMPLES])
    decay = 20 * np.exp(-t / 0.8)
    return np.stack([np.stack((decay, 0 * t), axis=1), np.stack((0 * t, decay), axis=1)]).astype(np.float32)


def test_a_point_is_simulated_once_for_all_that_a_view_cannot_see_and_for_all_weightings(view):
    gaps = Gaps(view)
    residual = _residual(gaps)
    seen = residual.moments([{"view.effect.size": 1.0}, {"view.effect.size": 1.0, "other.effect.size": 9.0}])
    again = residual.moments([{"other.effect.size": 2.0, "view.effect.size": 1.0}])
    _residual(gaps, weight=2.0).moments([{"view.effect.size": 1.0}])
    assert view.asked == [1]
    assert seen[0] is seen[1] is again[0]
    residual.moments([{"view.effect.size": float(i)} for i in range(5)])
    assert view.asked == [1, 4]  # the missing ones in one batch


def test_moments_are_those_of_the_rows(view):
    residual = _residual(Gaps(view), weight=0.25)
    moments = residual.moments([{"view.effect.size": 2.0}])[0]
    expected = 0.5 * view.gap([{"view.effect.size": 2.0}])[0].ravel()
    np.testing.assert_allclose(moments.rows, expected, rtol=1e-5, atol=1e-6)
    assert moments.rr == pytest.approx(float(expected @ expected), rel=1e-4)
    np.testing.assert_allclose(moments.gr, residual.columns @ moments.rows, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(residual.gg, residual.columns @ residual.columns.T, rtol=1e-4)


def test_another_start_costs_no_more_than_its_prior(view, starts):
    """Twice the usual change of a start: thousands of squares without, a few with its directions projected out."""
    view.gap = lambda points: 2.0 * starts[:1]
    bare, projected = _residual(Gaps(view)).moments([{}])[0].rr, _residual(Gaps(view), starts).moments([{}])[0].rr
    assert bare > 1000
    assert projected <= START_PRIOR * 2.0**2 * len(SAMPLES)


def test_trials_start_each_on_their_own(view, starts):
    moved = starts[0].copy()
    moved[SAMPLES[0] :] = 0.0
    view.gap = lambda points: moved[None]
    rows = _residual(Gaps(view), starts).moments([{}])[0].rows
    assert not rows[SAMPLES[0] * CHANNELS :].any()
    assert rows[: SAMPLES[0] * CHANNELS].any()


def test_residuals_other_than_a_start_survive(view, starts):
    point = [{"view.effect.size": 1.0}]
    bare, projected = _residual(Gaps(view)).moments(point)[0].rr, _residual(Gaps(view), starts).moments(point)[0].rr
    assert 0.9 * bare < projected <= bare


def test_blocks_hold_every_row_once_and_none_holds_two_trials(view):
    residual = _residual(Gaps(view))
    trial = np.repeat(view.trial, CHANNELS)
    rows = [np.arange(len(trial))[part] for _, part in residual.blocks]
    np.testing.assert_array_equal(np.concatenate(rows), np.arange(len(trial)))
    for (number, _), part in residual.blocks:
        assert set(trial[part]) == {number}
        assert part.stop - part.start <= BLOCK_S * RATE_HZ * CHANNELS + CHANNELS
