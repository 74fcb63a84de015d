"""95 % intervals of least-squares solutions whose residuals depend on their neighbours: blocks left out one at a time.

The scatter of the blocks' slopes (a sandwich), or a bootstrap of them, is too narrow where blocks are few.
MacKinnon, Nielsen and Webb 2023, Cluster-robust inference: a guide to empirical practice.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

Array = NDArray[np.float64]

RIDGE = 1e-10  # of the largest diagonal entry: what no block shows has no error, not an infinite one


def half_width(normal: Array, slope: Array, solution: Array) -> Array:
    """Half a 95 % interval of each unknown [k], Student's t with one degree of freedom less than there are blocks.

    normal: [B, k, k] normal matrices of the blocks; slope: [B, k] half gradients of their squares at zero; solution:
    [k] where the sum of all is least. Infinite for one block, which says nothing of its own error.
    """
    blocks = len(normal)
    if blocks < 2:
        return np.full(len(solution), np.inf)
    total = normal.sum(axis=0)
    without = total - normal + RIDGE * total.diagonal().max() * np.eye(len(total))
    moved = np.linalg.solve(without, (slope + normal @ solution)[:, :, None])[:, :, 0]
    return np.asarray(stdtrit(blocks - 1, 0.975) * np.sqrt((blocks - 1) / blocks * (moved**2).sum(axis=0)))
