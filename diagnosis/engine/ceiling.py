"""What any model could explain: a flexible one of the residual, scored on excitations that it has not seen.

Without it nobody knows whether what is left is noise or an effect that nobody has named.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.view import Array, View
from softarm.diagnosis.engine.whitened import slices

LAGS_S = (0.05, 0.133, 0.333, 0.75)  # of every feature
THIN_S = 0.05  # what is looked at: neighbours say the same
ROWS_MOST = 12_000
COMPONENTS = 2  # of the channels together
FOLDS_MAX = 4
TREES = 60
TURN_SHARE = 0.02  # of a signal's range: a smaller turn is none


def explainable(
    view: View, residual: NDArray[np.floating], folds: NDArray[np.int64], pace: float = 1.0
) -> tuple[float, dict[str, float]]:
    """Share of a residual's energy [M, S] that a flexible model finds on folds [M] it has not seen, and what it uses.

    Boosted trees on inputs, measured states, what the law with the named effects says (measured less residual), their
    past, and where each last turned, which is what play and hysteresis remember. 0 when it finds nothing.
    Deterministic. pace: the view's time over the robot's, for how far back it looks.
    """
    from sklearn.ensemble import HistGradientBoostingRegressor

    scaled = np.nan_to_num(residual / view.floor)
    seen = np.flatnonzero(np.isfinite(residual).all(axis=1))
    if not len(seen):
        return 0.0, {}
    rows = seen[:: max(samples(view, pace * THIN_S), len(seen) // ROWS_MOST, 1)]
    names, columns = _features(view, residual, rows, pace)
    targets = _components(scaled[rows])
    groups = np.unique(folds[rows], return_inverse=True)[1] % FOLDS_MAX
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
            model.fit(columns[~out], target[~out])
            error = target[out] - model.predict(columns[out])
            left += float(error @ error)
        used += np.abs(_correlations(columns, target)) * float(target @ target)
    share = max(0.0, 1 - left / total) if total > 0 else 0.0
    return share, _ranked(names, used)


def samples(view: View, seconds: float) -> int:
    """How many of a view's samples a time is, at least one."""
    return max(1, round(seconds / float(np.median(np.diff(view.t_s[slices(view.trial)[0]])))))


def _features(
    view: View, residual: NDArray[np.floating], rows: NDArray[np.int64], pace: float
) -> tuple[list[str], Array]:
    """Every feature now, before and where it last turned, [N, F], and the name of each column's feature."""
    names, columns = [], []
    parts = slices(view.trial)
    first = np.concatenate([np.full(part.stop - part.start, part.start) for part in parts])
    signals = dict(view.features)
    late = tuple(samples(view, pace * lag_s) for lag_s in LAGS_S)
    predicted = np.asarray(view.measured - residual, dtype=float)
    for s, channel in enumerate(view.channels):
        signals[f"{channel}, simulated"] = _filled(predicted[:, s])
    for name, values in signals.items():
        # Before a trial its first value: what was then, nobody knows; another trial's end least of all.
        # What the view itself measured less what is simulated is the residual, noise and all: only its past is shown.
        for lag in late if name in view.echoes else (0, *late):
            names.append(name)
            columns.append(values[np.maximum(rows - lag, first[rows])])
        if name not in view.echoes:
            names.append(name)
            columns.append(np.concatenate([turned(values[part]) for part in parts])[rows])
    return names, np.stack(columns, axis=1)


def turned(values: Array) -> Array:
    """Where a signal [T] last turned round by more than a share of its range; at first where it began."""
    least = TURN_SHARE * float(np.ptp(values))
    found, extreme, last, rising = np.empty(len(values)), values[0], values[0], True
    for i, value in enumerate(values):
        ahead = value > extreme if rising else value < extreme
        if ahead:
            extreme = value
        elif abs(value - extreme) > least:
            last, extreme, rising = extreme, value, not rising
        found[i] = last
    return found


def _filled(values: Array) -> Array:
    """Gaps closed by straight lines."""
    seen = np.isfinite(values)
    if seen.all() or not seen.any():
        return np.nan_to_num(values)
    at = np.arange(len(values))
    return np.interp(at, at[seen], values[seen])


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
    found, least = {}, samples(view, 2.0)
    for name, mask in view.regimes.items():
        part = residual[mask]
        if np.isfinite(part).any() and mask.sum() > least:
            found[name] = float(np.sqrt(np.nanmean(part**2)))
    return found
