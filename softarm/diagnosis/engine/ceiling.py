"""Upper bound of the explainable gap: a flexible model of the residual, scored on held-out excitations.

It separates noise from an effect that is missing in the list.
"""

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.view import Array, View
from softarm.diagnosis.engine.whitened import slices

LAGS_S = (0.05, 0.133, 0.333, 0.75)  # delays of every feature
THIN_S = 0.05  # spacing of the samples used
ROWS_MOST = 12_000
COMPONENTS = 2  # principal components of the channels
FOLDS_MAX = 4
TREES = 60
TURN_SHARE = 0.02  # smallest reversal, in ranges of the signal


def explainable(
    view: View, residual: NDArray[np.floating], folds: NDArray[np.int64], pace: float = 1.0
) -> tuple[float, dict[str, float]]:
    """Return the share of a residual's energy that a flexible model finds on held-out folds, and its features.

    The model is boosted trees on inputs, measured and simulated signals, their past, and the value at their last
    reversal, which backlash and hysteresis remember. The result is deterministic, and 0 if nothing is found.

    Args:
        view: stage of the residual.
        residual: measured minus simulated with the named effects, [M, S].
        folds: fold of each sample, [M].
        pace: the view's time scale over the robot's; it scales the delays.
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
    """Return the number of a view's samples in a time, at least one."""
    return max(1, round(seconds / float(np.median(np.diff(view.t_s[slices(view.trial)[0]])))))


def _features(
    view: View, residual: NDArray[np.floating], rows: NDArray[np.int64], pace: float
) -> tuple[list[str], Array]:
    """Return the features, [N, F], and the name of each column: present, past, and value at the last reversal."""
    names, columns = [], []
    parts = slices(view.trial)
    first = np.concatenate([np.full(part.stop - part.start, part.start) for part in parts])
    signals = dict(view.features)
    late = tuple(samples(view, pace * lag_s) for lag_s in LAGS_S)
    predicted = np.asarray(view.measured - residual, dtype=float)
    for s, channel in enumerate(view.channels):
        signals[f"{channel}, simulated"] = _filled(predicted[:, s])
    for name, values in signals.items():
        # Before a trial's start its first value stands in. Of the view's own measurement only the past is a
        # feature: the present value minus the simulated one is the residual itself.
        for lag in late if name in view.echoes else (0, *late):
            names.append(name)
            columns.append(values[np.maximum(rows - lag, first[rows])])
        if name not in view.echoes:
            names.append(name)
            columns.append(np.concatenate([turned(values[part]) for part in parts])[rows])
    return names, np.stack(columns, axis=1)


def turned(values: Array) -> Array:
    """Return a signal's value at its last reversal, [T]; its first value until then."""
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
    """Fill gaps by linear interpolation."""
    seen = np.isfinite(values)
    if seen.all() or not seen.any():
        return np.nan_to_num(values)
    at = np.arange(len(values))
    return np.interp(at, at[seen], values[seen])


def _components(scaled: Array) -> Array:
    """Return the principal components of the channels, [N, 1 or 2]."""
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
