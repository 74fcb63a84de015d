"""Held-out losses that are simulated: laws have kinks, and a fit's last linearisation misleads beyond them."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine import box
from softarm.diagnosis.engine.candidates import Set, point_of, split
from softarm.diagnosis.engine.view import Array

if TYPE_CHECKING:
    from softarm.diagnosis.engine.fits import FitProblem

STRIDES = (1.0, 0.3)  # of a refit's step: how far it helps the others is tried


def held_out(problem: "FitProblem", effects: Set, x: Array, refits: Array) -> Array:
    """By block [B]: its squares after a refit without its fold, a Gauss-Newton step as far as it helps the others.

    x: [p] where the fit ended; refits: [F, p] where that step would end, fold by fold.
    """
    folds, strides = np.unique(problem.fold), STRIDES if len(x) else ()
    states = [x, *(x + s * (refit - x) for refit in refits for s in strides)]
    rr, gr = block_sums(problem, [point_of(effects, split(effects, state)) for state in states])
    gg = gram(problem)
    low, high = problem.nuisance_box(effects)
    lost = np.empty(len(problem.blocks))
    for k, fold in enumerate(folds):
        out = problem.fold == fold
        mine = [0, *range(1 + k * len(strides), 1 + (k + 1) * len(strides))]
        fits = [_rest(rr[i, ~out], gr[i, ~out], gg[~out], low, high) for i in mine]
        best = min(range(len(mine)), key=lambda i: fits[i][0])
        w, at = fits[best][1], mine[best]
        lost[out] = rr[at, out] + 2 * gr[at, out] @ w + np.einsum("i,bij,j->b", w, gg[out], w)
    return lost


def block_sums(problem: "FitProblem", points: list[dict[str, float]]) -> tuple[Array, Array]:
    """Squares [P, B] of each point's rows, and their products with the nuisance columns [P, B, q]."""
    place = {name: i for i, name in enumerate(problem.blocks)}
    rr = np.zeros((len(points), len(place)))
    gr = np.zeros((len(points), len(place), len(problem.nuisance_low)))
    for residual in problem.whitened:
        edges = [part.start for _, part in residual.blocks]  # they follow one another without gaps
        order = [place[name] for name, _ in residual.blocks]
        for p, moments in enumerate(residual.moments(points)):
            rows = moments.rows.astype(float)
            rr[p, order] += np.add.reduceat(rows * rows, edges)
            gr[p, order] += np.add.reduceat(residual.columns * rows, edges, axis=1).T
    return rr, gr


def gram(problem: "FitProblem") -> Array:
    """Products of the nuisance columns with one another, block by block, [B, q, q]."""
    place = {name: i for i, name in enumerate(problem.blocks)}
    found = np.zeros((len(place), len(problem.nuisance_low), len(problem.nuisance_low)))
    for residual in problem.whitened:
        found[[place[name] for name, _ in residual.blocks]] += residual.block_gg
    return found


def _rest(rr: Array, gr: Array, gg: Array, low: Array, high: Array) -> tuple[float, NDArray[np.float64]]:
    """Loss of some blocks, and the nuisances fitted to them."""
    normal, slope = gg.sum(axis=0), gr.sum(axis=0)
    w = box.solve(np.ascontiguousarray(normal), -slope, low, high)
    return float(rr.sum() + 2 * w @ slope + w @ normal @ w), w
