"""Intervals by leaving blocks out: right where the answer can be calculated, and as sure as they say."""

import numpy as np
import pytest
from scipy.stats import t

from softarm.diagnosis.engine.jackknife import covariance


def test_of_a_mean_it_is_the_textbook_s():
    values = np.random.default_rng(0).normal(size=9)
    found = covariance(np.ones((9, 1, 1)), -values[:, None], values.mean(keepdims=True))
    assert np.sqrt(found[0, 0]) == pytest.approx(t.ppf(0.975, 8) * values.std(ddof=1) / 3, rel=1e-6)


def test_an_invisible_unknown_has_no_error_and_one_block_has_an_infinite_one():
    design = np.random.default_rng(1).normal(size=(6, 20, 2)) * (1.0, 0.0)
    normal = np.einsum("bni,bnj->bij", design, design)
    assert covariance(normal, np.zeros((6, 2)), np.zeros(2))[1, 1] == 0.0
    assert not covariance(0 * normal, np.zeros((6, 2)), np.zeros(2)).any()  # a joint that nothing moves
    assert np.isinf(covariance(normal[:1], np.zeros((1, 2)), np.zeros(2)).diagonal()).all()
