"""The peer of the diagnosis's benchmark is fitted to the end, and not beyond it."""

import contextlib

import numpy as np
import pytest

from softarm.benchmarks.mujoco_sysid import REFUSED_MAX, _SettledError, _Watch

TRUE = np.array([1.3, 0.4])
T_S = np.linspace(0, 2, 300)
BOUNDS = [np.full(2, 0.01), np.full(2, 5.0)]


def _residual(x, parameters):
    """A decay under noise, rough in its tenth digit as simulations are: finite differences cannot see the bottom."""
    gap = x[0] * np.exp(-x[1] * T_S[:, None]) - (TRUE[0] * np.exp(-TRUE[1] * T_S) + 0.01 * np.cos(40 * T_S))[:, None]
    return [gap + 1e-10 * np.sin(1e9 * (x[0] + x[1]) + T_S[:, None])], [], []


def _fitted(residual, **options):
    minimize = pytest.importorskip("mujoco.minimize")
    return minimize.least_squares(np.ones(2), residual, BOUNDS, verbose=0, **options)[0].ravel()


def test_a_fit_ends_at_its_bottom_and_does_not_seek_below_the_noise():
    simulated = []

    def alone(x):
        simulated.extend(x.T)
        return _residual(x, None)[0][0]

    to_the_end = _fitted(alone)
    watch = _Watch(_residual)
    with contextlib.suppress(_SettledError):
        _fitted(lambda x: watch(x, None)[0][0], iter_callback=watch.ended)
    assert watch.simulations < len(simulated) / 4
    np.testing.assert_allclose(watch.best, to_the_end, rtol=1e-4)
    np.testing.assert_allclose(watch.best, TRUE, rtol=0.02)


def test_the_best_is_kept_whatever_is_tried_after_it():
    watch = _Watch(_residual)
    for x in (TRUE, np.array([3.0, 3.0])):
        watch(x[:, None], None)
    watch(np.tile(TRUE[:, None], 2), None)  # a Jacobian's columns are no candidates
    np.testing.assert_array_equal(watch.best, TRUE)
    assert watch.simulations == 4


def test_an_iteration_that_wins_next_to_nothing_is_the_last():
    class Round:
        objective = 1.0

        def __init__(self, reduction):
            self.reduction = reduction

    watch = _Watch(_residual)
    watch.ended([Round(0.01)])
    with pytest.raises(_SettledError):
        watch.ended([Round(0.01), Round(1e-6)])


def test_what_is_refused_for_long_is_sought_no_further():
    watch = _Watch(_residual)
    watch(TRUE[:, None], None)
    worse = np.ones((2, 1))
    for _ in range(REFUSED_MAX - 1):
        watch(worse, None)
    with pytest.raises(_SettledError):
        watch(worse, None)
    np.testing.assert_array_equal(watch.best, TRUE)
