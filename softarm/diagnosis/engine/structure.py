"""Structure in a residual that noise does not have: a mean or an autocorrelation in some part of the data.

Each look at a part of the data is a test over blocks. The tests are corrected together (Bonferroni), so that noise
alone shows structure in at most `LEVEL` of all cases.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from softarm.diagnosis.engine.view import Array, View
from softarm.diagnosis.engine.whitened import BLOCK_S, blocks_of, samples, slices

LEVEL = 0.01  # family-wise error rate of all looks
LAGS_S = (0.05, 0.1, 0.2, 0.4)  # lags of the autocorrelation, for blocks of BLOCK_S
BLOCKS_LEAST = 5  # smallest sample of a test


@dataclass(frozen=True, slots=True)
class Structure:
    """Structure in a residual that noise does not have."""

    energy: float  # energy of the strongest significant finding; 0 without one
    where: str  # place and kind of that finding in words


def structure(
    view: View, residual: NDArray[np.floating], kinds: Sequence[str] = (), block_s: float = BLOCK_S
) -> Structure:
    """Test a residual [M, S] of a view in every part of the data; kinds: excitation of each trial."""
    scaled = np.asarray(residual, dtype=float) / view.floor
    places = dict(_places(view, kinds))
    found = [(name, *sign) for name, mask in places.items() for sign in _looks(view, scaled, mask, block_s)]
    sure = [(energy, words, name) for name, words, energy, p in found if p < LEVEL / len(found)]
    energy, words, name = max(sure, default=(0.0, "", ""))
    return Structure(energy, f"{name}, {words}" if words else "")


def _places(view: View, kinds: Sequence[str]) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    everywhere = np.ones(len(view.trial), dtype=bool)
    yield "throughout", everywhere
    late = np.zeros_like(everywhere)
    for part in slices(view.trial):
        late[(part.start + part.stop) // 2 : part.stop] = True
    yield "in the second half of the trials", late
    yield "in the first half of the trials", ~late
    for kind in sorted(set(kinds)) if len(set(kinds)) > 1 else []:
        yield f"in {kind}", np.isin(view.trial, [k for k, each in enumerate(kinds) if each == kind])
    yield from view.regimes.items()


def _looks(view: View, scaled: Array, mask: NDArray[np.bool_], block_s: float) -> Iterator[tuple[str, float, float]]:
    """Yield the words, energy and p-value of each test on a part of the data."""
    lags = sorted({samples(view, lag * (block_s / BLOCK_S)) for lag in LAGS_S})
    blocks = [slice(a, b) for _, a, b in blocks_of(view, block_s)]
    for s, channel in enumerate(view.channels):
        r = np.where(mask, scaled[:, s], np.nan)
        mean, p = over_blocks([r[b] for b in blocks])
        yield f"{channel} has a mean error", mean**2, p
        for lag in lags:
            products = [r[b][lag:] * r[b][:-lag] if b.stop - b.start > lag else np.zeros(0) for b in blocks]
            energy, p = over_blocks(products)
            yield f"{channel} is autocorrelated", abs(energy), p


def over_blocks(parts: Sequence[Array]) -> tuple[float, float]:
    """Return the mean of all blocks and its two-sided p-value, with the blocks' means as the sample."""
    filled = [part for part in parts if len(part)]
    if len(filled) < BLOCKS_LEAST:
        return 0.0, 1.0
    values, starts = np.concatenate(filled), np.cumsum([0, *map(len, filled[:-1])])
    known = np.isfinite(values)
    weights = np.add.reduceat(known, starts, dtype=float)
    kept = weights > 0.2 * max(weights.max(), 1.0)
    if kept.sum() < BLOCKS_LEAST:
        return 0.0, 1.0
    means = np.add.reduceat(np.where(known, values, 0.0), starts)[kept] / weights[kept]
    mean = float(np.average(means, weights=weights[kept]))
    error = float(means.std(ddof=1)) / np.sqrt(len(means))
    if error <= 0:
        return mean, 1.0 if mean == 0 else 0.0
    return mean, float(2 * stdtr(len(means) - 1, -abs(mean) / error))
