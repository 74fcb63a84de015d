"""Is what is left noise? Many local looks at a residual, and one decision with one level of error.

A residual that no law is missing from does not carry on from sample to sample, has no mean in any regime and is alike
early and late, in every kind of excitation. Each of these is one test, its blocks the sample; together they are one
(Bonferroni), so that a long list of looks finds nothing in noise more often than `LEVEL` says.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from softarm.diagnosis.engine.view import Array, View
from softarm.diagnosis.engine.whitened import BLOCK_S, blocks_of, slices

LEVEL = 0.01  # of all looks together: how often noise alone is said to have structure
LAGS_S = (0.05, 0.1, 0.2, 0.4)  # over which a residual carries on, or comes back with the other sign; of BLOCK_S
BLOCKS_LEAST = 5  # fewer say nothing of their own scatter


@dataclass(frozen=True, slots=True)
class Structure:
    """What a residual has that noise has not."""

    energy: float  # of the strongest sure sign, mean square over the floor's; 0 where there is none
    where: str  # of that sign, in words; '' where there is none
    signs: int  # sure ones
    looks: int


def structure(
    view: View, residual: NDArray[np.floating], kinds: Sequence[str] = (), block_s: float = BLOCK_S
) -> Structure:
    """Look at a residual [M, S] of a view everywhere. kinds: of every trial of the view, its excitation."""
    scaled = np.asarray(residual, dtype=float) / view.floor
    places = dict(_places(view, kinds))
    found = [(name, *sign) for name, mask in places.items() for sign in _looks(view, scaled, mask, block_s)]
    sure = [(energy, words, name) for name, words, energy, p in found if p < LEVEL / len(found)]
    energy, words, name = max(sure, default=(0.0, "", ""))
    return Structure(energy, f"{name}, {words}" if words else "", len(sure), len(found))


def _places(view: View, kinds: Sequence[str]) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Parts of the data that are looked at, each by name."""
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


def _looks(
    view: View, scaled: Array, mask: NDArray[np.bool_], block_s: float = BLOCK_S
) -> Iterator[tuple[str, float, float]]:
    """In words, energy and p-value of every look at a part of the data: a mean, and what carries on."""
    step = float(np.median(np.diff(view.t_s[slices(view.trial)[0]])))
    lags = sorted({max(1, round(lag * (block_s / BLOCK_S) / step)) for lag in LAGS_S})
    blocks = [slice(a, b) for _, a, b in blocks_of(view, block_s)]
    for s, channel in enumerate(view.channels):
        r = np.where(mask, scaled[:, s], np.nan)
        mean, p = over_blocks([r[b] for b in blocks])
        yield f"{channel} is off on the whole", mean**2, p
        for lag in lags:
            products = [r[b][lag:] * r[b][:-lag] if b.stop - b.start > lag else np.zeros(0) for b in blocks]
            energy, p = over_blocks(products)
            yield f"{channel} carries on", abs(energy), p


def over_blocks(parts: Sequence[Array]) -> tuple[float, float]:
    """Mean of all and its two-sided p-value against none, the blocks' means taken as independent."""
    weights = np.array([np.isfinite(part).sum() for part in parts], dtype=float)
    kept = weights > 0.2 * max(weights.max(initial=0.0), 1.0)
    if kept.sum() < BLOCKS_LEAST:
        return 0.0, 1.0
    means = np.array([np.nanmean(part) for part, keep in zip(parts, kept, strict=True) if keep])
    mean = float(np.average(means, weights=weights[kept]))
    error = float(means.std(ddof=1)) / np.sqrt(len(means))
    if error <= 0:
        return mean, 1.0 if mean == 0 else 0.0
    return mean, float(2 * stdtr(len(means) - 1, -abs(mean) / error))


def strongest(found: Mapping[str, Structure]) -> tuple[str, Structure] | None:
    """Stage and structure of the strongest sign; None without one."""
    sure = [(each.energy, stage) for stage, each in found.items() if each.signs]
    return (max(sure)[1], found[max(sure)[1]]) if sure else None
