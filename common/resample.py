"""One bootstrap (Efron 1979): what a figure would be, had other blocks of the same kind been recorded."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

DRAWS = 2000
TAILS = (0.025, 0.975)  # of a 95 % interval


@cache
def draws(blocks: int) -> Array:
    """How often each of the blocks is drawn, [DRAWS, blocks], with replacement; the same draws every time.

    Floats, so that a figure's sum over blocks is one matrix product; read-only. Raises ValueError for no block.
    """
    if blocks < 1:
        raise ValueError(f"{blocks} blocks: there is nothing to draw from; give one or more")
    drawn = np.random.default_rng(0).multinomial(blocks, np.full(blocks, 1 / blocks), DRAWS).astype(np.float64)
    drawn.flags.writeable = False
    return drawn


def interval(figures: NDArray[np.floating]) -> tuple[Array, Array]:
    """95 % interval of a figure from its value at each draw, [DRAWS, ...]: the percentiles, low and high, [...]."""
    low, high = np.quantile(figures, TAILS, axis=0)
    return np.asarray(low), np.asarray(high)
