"""Held-out losses from simulations, for laws with kinks that a fit's last linearisation does not describe."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine import box
from softarm.diagnosis.engine.candidates import EffectSet, point_of, split
from softarm.diagnosis.engine.view import Array, Point
from softarm.diagnosis.engine.whitened import WhitenedResidual

Block = tuple[int, int]  # trial, number
STRIDES = (1.0, 0.3)  # fractions of a refit's step that are simulated


class BlockSums:
    """Sums of squares and products of whitened residuals, block by block."""

    def __init__(self, whitened: Sequence[WhitenedResidual], blocks: Sequence[Block]) -> None:
        self._whitened = tuple(whitened)
        self._place = {name: i for i, name in enumerate(blocks)}

    def residuals(self, points: Sequence[Point]) -> tuple[Array, Array]:
        """Return the squares [P, B] of each point's rows and their products with the nuisance columns [P, B, q]."""
        q = len(self._whitened[0].columns)
        rr = np.zeros((len(points), len(self._place)))
        gr = np.zeros((len(points), len(self._place), q))
        for residual in self._whitened:
            edges = [part.start for _, part in residual.blocks]  # contiguous
            order = [self._place[name] for name, _ in residual.blocks]
            for p, moments in enumerate(residual.moments(points)):
                rows = moments.rows.astype(float)
                rr[p, order] += np.add.reduceat(rows * rows, edges)
                gr[p, order] += np.add.reduceat(residual.columns * rows, edges, axis=1).T
        return rr, gr

    def gram(self) -> Array:
        """Return the products of the nuisance columns with one another, [B, q, q]."""
        q = len(self._whitened[0].columns)
        found = np.zeros((len(self._place), q, q))
        for residual in self._whitened:
            found[[self._place[name] for name, _ in residual.blocks]] += residual.block_gg
        return found


def simulated_losses(
    sums: BlockSums, fold: NDArray[np.int64], limits: tuple[Array, Array], effects: EffectSet, x: Array, refits: Array
) -> Array:
    """Return each block's loss [B] after a refit without its fold.

    A refit is a Gauss-Newton step, shortened if the shorter step fits the remaining blocks better.

    Args:
        sums: sums of the problem's blocks.
        fold: fold of each block, [B].
        limits: low and high of the nuisance coordinates, [q] each.
        effects: fitted effects.
        x: coordinates of the fit, [p].
        refits: coordinates after the step without each fold, [F, p].
    """
    folds, strides = np.unique(fold), STRIDES if len(x) else ()
    states = [x, *(x + s * (refit - x) for refit in refits for s in strides)]
    rr, gr = sums.residuals([point_of(effects, split(effects, state)) for state in states])
    gg = sums.gram()
    lost = np.empty(len(fold))
    for k, each in enumerate(folds):
        out = fold == each
        mine = [0, *range(1 + k * len(strides), 1 + (k + 1) * len(strides))]
        others = gg[~out].sum(axis=0)
        fits = [fit_nuisances(rr[i, ~out].sum(), gr[i, ~out].sum(axis=0), others, limits) for i in mine]
        best = min(range(len(mine)), key=lambda i: fits[i][0])
        w, at = fits[best][1], mine[best]
        lost[out] = rr[at, out] + 2 * gr[at, out] @ w + np.einsum("i,bij,j->b", w, gg[out], w)
    return lost


def fit_nuisances(rr: float, gr: Array, gg: Array, limits: tuple[Array, Array]) -> tuple[float, Array]:
    """Return the loss and the nuisances [q] that fit best, from sums of squares and products."""
    w = box.solve(gg, -gr, *limits)
    return float(rr + 2 * w @ gr + w @ gg @ w), w
