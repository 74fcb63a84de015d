"""Bootstrap (Efron 1979): the distribution of a figure over resampled blocks of the recordings."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.view import Array

DRAWS = 2000
# Quantiles of a 95 % interval.
TAILS = (0.025, 0.975)


@cache
def draws(blocks: int) -> Array:
    """Return how often each block is drawn with replacement [DRAWS, blocks]; the draws are always the same.

    The read-only array has floats, so a sum over blocks is a matrix product.
    """
    drawn = np.random.default_rng(0).multinomial(blocks, np.full(blocks, 1 / blocks), DRAWS).astype(np.float64)
    drawn.flags.writeable = False
    return drawn


def interval(figures: NDArray[np.floating]) -> tuple[Array, Array]:
    """Return the bounds of the 95 % interval of a figure from its value at each draw [DRAWS, ...]."""
    low, high = np.quantile(figures, TAILS, axis=0)
    return np.asarray(low), np.asarray(high)
