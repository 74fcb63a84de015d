"""What any model could explain: a flexible one of the residual, scored on excitations that it has not seen.

Without it nobody knows whether what is left is noise or an effect that nobody has named.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.view import Array, View
from softarm.diagnosis.engine.whitened import slices

LAGS = (3, 8, 20, 45)  # samples, of every feature
THIN = 3  # every third sample: neighbours say the same
COMPONENTS = 2  # of the channels together
FOLDS_MAX = 4
TREES = 60


def explainable(view: View, residual: NDArray[np.floating], folds: NDArray[np.int64]) -> tuple[float, dict[str, float]]:
    """Share of a residual's energy [M, S] that a flexible model finds on folds [M] it has not seen, and what it uses.

    Boosted trees on inputs, measured states and their past. 0 when it finds nothing. Deterministic.
    """
    from sklearn.ensemble import HistGradientBoostingRegressor

    names, columns = _features(view)
    scaled = np.nan_to_num(residual / view.floor)
    seen = np.isfinite(residual).all(axis=1)
    rows = np.flatnonzero(seen)[::THIN]
    targets = _components(scaled[rows])
    groups = folds[rows] % FOLDS_MAX
    total, left, used = 0.0, 0.0, np.zeros(len(names))
    for target in targets.T:
        total += float(target @ target)
        for fold in np.unique(groups):
            out = groups == fold
            if out.all():
                return 0.0, {}
            model = HistGradientBoostingRegressor(
                max_iter=TREES, max_leaf_nodes=12, min_samples_leaf=40, l2_regularization=1.0, random_state=0
            )
            model.fit(columns[rows][~out], target[~out])
            error = target[out] - model.predict(columns[rows][out])
            left += float(error @ error)
        used += np.abs(_correlations(columns[rows], target)) * float(target @ target)
    share = max(0.0, 1 - left / total) if total > 0 else 0.0
    return share, _ranked(names, used)


def _features(view: View) -> tuple[list[str], Array]:
    """Every feature now and before, [M, F], and the name of each column's feature; before a trial its first value."""
    names, columns = [], []
    now = np.arange(len(view.trial))
    first = np.concatenate([np.full(part.stop - part.start, part.start) for part in slices(view.trial)])
    for name, values in view.features.items():
        for lag in (0, *LAGS):
            names.append(name)
            columns.append(values[np.maximum(now - lag, first)])
    return names, np.stack(columns, axis=1)


def _components(scaled: Array) -> Array:
    """The strongest directions of the channels, [N, 1 or 2]."""
    if scaled.shape[1] == 1:
        return scaled
    _, _, directions = np.linalg.svd(scaled[::4], full_matrices=False)
    return np.asarray(scaled @ directions[:COMPONENTS].T)


def _correlations(columns: Array, target: Array) -> Array:
    centred = columns - columns.mean(axis=0)
    size = np.sqrt((centred**2).sum(axis=0) * max(float(((target - target.mean()) ** 2).sum()), 1e-30))
    return np.asarray((centred * (target - target.mean())[:, None]).sum(axis=0) / np.maximum(size, 1e-30))


def _ranked(names: list[str], used: Array) -> dict[str, float]:
    best: dict[str, float] = {}
    for name, weight in zip(names, used, strict=True):
        best[name] = max(best.get(name, 0.0), float(weight))
    total = sum(best.values()) or 1.0
    return dict(sorted(((n, w / total) for n, w in best.items()), key=lambda each: -each[1])[:5])


def regimes(view: View, residual: NDArray[np.floating]) -> Mapping[str, float]:
    """Regime -> RMS of a residual there, in the view's unit; regimes of less than two seconds are left out."""
    found = {}
    for name, mask in view.regimes.items():
        part = residual[mask]
        if np.isfinite(part).any() and mask.sum() > 120:
            found[name] = float(np.sqrt(np.nanmean(part**2)))
    return found
