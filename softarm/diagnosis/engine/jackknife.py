"""95 % intervals of least-squares solutions with autocorrelated residuals, by a jackknife over blocks.

A sandwich estimate or a bootstrap of the blocks is too narrow if there are few.
MacKinnon, Nielsen and Webb 2023, Cluster-robust inference: a guide to empirical practice.
"""

import numpy as np
from scipy.special import stdtrit

from softarm.diagnosis.engine.view import Array

# Share of the largest diagonal entry, and the least such entry.
RIDGE, LEAST = 1e-10, 1e-30


def ridge(normal: Array) -> float:
    """Return what is added to the diagonal of a normal matrix: an invisible unknown gets no error, not infinity."""
    return RIDGE * max(float(normal.diagonal().max()), LEAST)


def covariance(normal: Array, slope: Array, solution: Array) -> Array:
    """Return the covariance of the unknowns, [k, k], times the square of Student's t for 95 %.

    The root of its diagonal is half the interval of each unknown; it is infinite for a single block.

    Args:
        normal: normal matrices of the blocks, [B, k, k].
        slope: half gradients of the blocks' squares at zero, [B, k].
        solution: minimum of the sum of all blocks, [k].
    """
    blocks = len(normal)
    if blocks < 2:
        return np.diag(np.full(len(solution), np.inf))
    total = normal.sum(axis=0)
    without = total - normal + ridge(total) * np.eye(len(total))
    moved = np.linalg.solve(without, (slope + normal @ solution)[:, :, None])[:, :, 0]
    return np.asarray(stdtrit(blocks - 1, 0.975) ** 2 * (blocks - 1) / blocks * (moved.T @ moved))
