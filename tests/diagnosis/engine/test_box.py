"""Least squares in a box: as good as scipy's, on problems of the kind that a fit poses."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from softarm.diagnosis.engine import box


def _problem(seed, alike=0.0):
    """A random problem: matrix, right side, box; some boxes are so narrow that they bind.

    alike: 0 .. 1, how much the second column is the first one.
    """
    draw = np.random.default_rng(seed)
    q = int(draw.integers(2, 9))
    matrix = draw.normal(size=(60, q)) * 10 ** draw.uniform(-1, 1, q)
    size = np.linalg.norm(matrix[:, 0])
    matrix[:, 1] = alike * matrix[:, 0] + (1 - alike) * matrix[:, 1] * size / np.linalg.norm(matrix[:, 1])
    right = matrix @ draw.normal(size=q) + draw.normal(size=60)
    low = -draw.uniform(0, 1.5, q)
    return matrix, right, low, low + draw.uniform(0.1, 2.0, q)


def _squares(matrix, right, x):
    return float(np.sum((matrix @ x - right) ** 2))


@pytest.mark.parametrize("alike", [0.0, 0.8, 0.99, 0.9999])
def test_it_is_as_good_as_an_exact_solver_and_stays_in_the_box(alike):
    """Also where two columns are nearly one: an effect beside the nuisance that resembles it."""
    for seed in range(20):
        matrix, right, low, high = _problem(seed, alike)
        found = box.solve(matrix.T @ matrix, matrix.T @ right, low, high)
        best = lsq_linear(matrix, right, (low, high), tol=1e-12).x
        assert (found >= low).all()
        assert (found <= high).all()
        assert _squares(matrix, right, found) <= _squares(matrix, right, best) * (1 + 1e-9), seed


def test_a_coordinate_without_influence_stays():
    normal, slope = np.diag([2.0, 0.0, 4.0]), np.array([2.0, 0.0, 20.0])
    found = box.solve(normal, slope, np.array([-3.0, -3.0, -3.0]), np.array([3.0, 3.0, 3.0]))
    np.testing.assert_allclose(found, [1.0, 0.0, 3.0], atol=1e-6)


def test_a_shut_box_is_its_one_point():
    found = box.solve(np.eye(2), np.array([5.0, 5.0]), np.array([0.0, 0.7]), np.array([0.0, 0.7]))
    np.testing.assert_array_equal(found, [0.0, 0.7])


def test_no_unknowns_are_no_problem():
    assert box.solve(np.zeros((0, 0)), np.zeros(0), np.zeros(0), np.zeros(0)).shape == (0,)
