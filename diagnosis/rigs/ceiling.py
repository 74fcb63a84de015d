"""What any model could still explain of a residual: ridge on random smooth features, on folds that it has not seen."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.view import Array

FEATURES = 150
RIDGE = 0.1  # a sample's share of the normal equations' trace
SAMPLES_MAX = 12_000


def ceiling(
    residual: Array, features: Mapping[str, Array], fold: NDArray[np.int64]
) -> tuple[Array, tuple[tuple[str, float], ...]]:
    """RMS by channel [S] that a flexible model leaves, and what it leans on, the most important feature first.

    residual: [M, S], NaN where nothing was measured; features: name -> [M]; fold: [M]. A feature's importance is the
    share of the residual's energy that returns when it is shuffled. Rahimi and Recht 2007, Random features.
    """
    seen = np.flatnonzero(np.isfinite(residual).all(axis=1))
    seen = seen[:: max(1, len(seen) // SAMPLES_MAX)]
    names, y, groups = tuple(features), residual[seen], fold[seen]
    x = np.stack([_even(features[name][seen]) for name in names], axis=1)
    draw = np.random.default_rng(0)
    weights = draw.normal(size=(len(names), FEATURES)) * draw.choice((0.5, 1.0, 2.0), FEATURES)
    phases = draw.uniform(0, 2 * np.pi, FEATURES)
    shuffled = draw.permutation(len(seen))
    left, back = np.zeros_like(y), np.zeros((len(names), y.shape[1]))
    for each in np.unique(groups):
        out = groups == each
        learned = _fit(_map(x[~out], weights, phases), y[~out]) if (~out).any() else np.zeros((FEATURES, y.shape[1]))
        left[out] = y[out] - _map(x[out], weights, phases) @ learned
        for i in range(len(names)):
            mixed = x[out].copy()
            mixed[:, i] = x[shuffled[out], i]
            back[i] += ((y[out] - _map(mixed, weights, phases) @ learned) ** 2).sum(axis=0)
    energy = (y**2).sum(axis=0)
    after = np.minimum((left**2).sum(axis=0), energy)
    if after.sum() >= energy.sum() * 0.98:
        return np.sqrt(energy / len(y)), ()
    share = (back.sum(axis=1) - (left**2).sum()) / energy.sum()
    leans: Sequence[int] = [int(i) for i in np.argsort(-share) if share[i] > 0.02]
    return np.sqrt(after / len(y)), tuple((names[i], float(share[i])) for i in leans)


def _even(values: Array) -> Array:
    """A feature's ranks, -1.7 to 1.7: outliers and units do not count."""
    order = np.argsort(np.argsort(values, kind="stable"), kind="stable")
    return np.asarray((order / max(len(values) - 1, 1) - 0.5) * 3.4)


def _map(x: Array, weights: Array, phases: Array) -> Array:
    return np.asarray(np.cos(x @ weights + phases))


def _fit(basis: Array, y: Array) -> Array:
    normal = basis.T @ basis
    normal[np.diag_indices(len(normal))] += RIDGE * np.trace(normal) / len(normal)
    return np.asarray(np.linalg.solve(normal, basis.T @ y))
