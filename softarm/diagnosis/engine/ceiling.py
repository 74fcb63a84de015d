"""Upper bound of the explainable gap: a flexible model of the residual, scored on held-out data.

It separates noise from an effect that is missing in the list. What it explains of a residual is evidence for an effect
only if it explains less of surrogates: the same residual without its relation to the inputs.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.view import Array, View
from softarm.diagnosis.engine.whitened import samples, slices

LAGS_S = (0.05, 0.133, 0.333, 0.75)  # delays of every feature
THIN_S = 0.05  # spacing of the samples used
ROWS_MOST = 12_000
COMPONENTS = 2  # principal components of the channels
FOLDS_MAX = 4
TREES = 60
TURN_SHARE = 0.02  # smallest reversal, in ranges of the signal
SIMULATED = ", simulated"  # end of the name of a simulated signal
SURROGATES = 19  # a residual without any law exceeds all of them in one of twenty cases
TRIALS_SHUFFLED = 3  # trials that give enough orders, signs and directions
# A hum, a disturbance of one frequency, depends on no signal, so that no model of the signals finds it.
HUM_LEVEL = 0.05  # share of residuals without a hum in which one is found
HUM_CYCLES_LEAST = 5.0  # in the longest trial; a window of a swing holds four periods of its own
HUM_NEIGHBOURS = 20  # frequencies on either side that show the level of the noise
HUM_WIDTH = 4  # frequencies on either side that hold a line, with a Hann window and twice its length


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
    scaled = np.nan_to_num(residual / view.floor)
    rows = _rows(view, residual, pace)
    if len(np.unique(folds[rows])) < 2:
        return 0.0, {}
    names, columns = _features(view, _signals(view, residual), rows, pace)
    targets = _components(scaled[rows])
    used = np.zeros(len(names))
    for target in targets.T:
        used += np.abs(_correlations(columns, target)) * float(target @ target)
    return _held_out(columns, targets, folds[rows]), _ranked(names, used)


def beyond_chance(view: View, residual: NDArray[np.floating], folds: NDArray[np.int64], pace: float = 1.0) -> float:
    """Return the share of a residual's energy that a flexible model finds, or 0 if it finds as much in a surrogate.

    Neighbouring blocks may share a slow error, and so do those of a surrogate. Features without the view's own
    measurement, which holds the residual's past, are completed by the integrals of the simulated signals. Arguments as
    for `explainable`; the folds come from all parts of the data.
    """
    rows = _rows(view, residual, pace)
    if len(np.unique(folds[rows])) < 2:
        return 0.0
    signals = {name: x for name, x in _signals(view, residual).items() if name not in view.echoes}
    simulated = [name for name in signals if name.endswith(SIMULATED)]
    parts = slices(view.trial)
    signals |= {f"{name}, summed": np.concatenate([np.cumsum(signals[name][p]) for p in parts]) for name in simulated}
    _, columns = _features(view, signals, rows, pace)
    scaled = np.nan_to_num(residual / view.floor)
    share, random = _held_out(columns, _components(scaled[rows]), folds[rows]), np.random.default_rng(0)
    for _ in range(SURROGATES):
        other = _surrogate(scaled, parts, random)
        if _held_out(columns, _components(other[rows]), folds[rows]) >= share:
            return 0.0
    return share


def hum(view: View, residual: NDArray[np.floating]) -> float:
    """Return the share of a residual's [M, S] energy in its strongest line, or 0 if noise may have such a line.

    The power of noise at one frequency exceeds x times the median of its neighbours with a probability of at most
    2^-x, whatever its colour; the sum over trials is closer to its median.
    """
    parts, scaled = slices(view.trial), np.nan_to_num(np.asarray(residual, dtype=float) / view.floor)
    longest = max(parts, key=lambda part: part.stop - part.start)
    size = 2 * (longest.stop - longest.start)
    power = np.zeros(size // 2 + 1)
    for part in parts:
        taper = np.hanning(part.stop - part.start)[:, None]
        centred = scaled[part] - scaled[part].mean(axis=0)
        power += (np.abs(np.fft.rfft(centred * taper, n=size, axis=0)) ** 2).sum(axis=1)
    if len(power) <= 2 * HUM_NEIGHBOURS:
        return 0.0
    around = [np.median(power[max(k - HUM_NEIGHBOURS, 0) : k + HUM_NEIGHBOURS + 1]) for k in range(len(power))]
    ratio = power / np.maximum(around, 1e-30)
    peak = HUM_WIDTH + int(np.argmax(ratio[HUM_WIDTH:]))
    if peak < 2 * HUM_CYCLES_LEAST or ratio[peak] <= np.log2(len(ratio) / HUM_LEVEL):
        return 0.0
    return float(power[peak - HUM_WIDTH : peak + HUM_WIDTH + 1].sum() / power.sum())


def _surrogate(scaled: Array, parts: list[slice], random: np.random.Generator) -> Array:
    """Return a residual [M, S] with each trial's in another trial, half of them negated, some of them reversed.

    Of few trials the phases are random instead.
    """
    found, order = np.empty_like(scaled), random.permutation(len(parts))
    for i, (here, there) in enumerate(zip(order, np.roll(order, 1), strict=True)):
        part, length = parts[here], parts[here].stop - parts[here].start
        if len(parts) < TRIALS_SHUFFLED:
            turn = np.exp(2j * np.pi * random.random(length // 2 + 1))
            turn[0] = turn[-1] = 1.0  # of the mean, and of the highest frequency
            taken = np.fft.irfft(np.fft.rfft(scaled[part], axis=0) * turn[:, None], n=length, axis=0)
        else:
            taken = np.resize(scaled[parts[there]], (length, scaled.shape[1]))
        found[part] = (-1.0) ** i * taken[:: random.choice((-1, 1))]
    return found


def _rows(view: View, residual: NDArray[np.floating], pace: float) -> NDArray[np.int64]:
    """Return the samples that are used, [N]."""
    seen = np.flatnonzero(np.isfinite(residual).all(axis=1))
    return seen[:: max(samples(view, pace * THIN_S), len(seen) // ROWS_MOST, 1)]


def _held_out(columns: Array, targets: Array, folds: NDArray[np.int64]) -> float:
    """Return the share of the targets' energy that boosted trees find on held-out folds."""
    from sklearn.ensemble import HistGradientBoostingRegressor

    groups = np.unique(folds, return_inverse=True)[1] % FOLDS_MAX
    total, left = float((targets**2).sum()), 0.0
    for target in targets.T:
        for fold in np.unique(groups):
            out = groups == fold
            model = HistGradientBoostingRegressor(
                max_iter=TREES, max_leaf_nodes=12, min_samples_leaf=40, l2_regularization=1.0, random_state=0
            )
            model.fit(columns[~out], target[~out])
            error = target[out] - model.predict(columns[out])
            left += float(error @ error)
    return max(0.0, 1 - left / total) if total > 0 else 0.0


def _signals(view: View, residual: NDArray[np.floating]) -> dict[str, Array]:
    """Return inputs, measured and simulated signals by name, [M] each."""
    predicted = np.asarray(view.measured - residual, dtype=float)
    simulated = {f"{channel}{SIMULATED}": _filled(predicted[:, s]) for s, channel in enumerate(view.channels)}
    return {**view.features, **simulated}


def _features(
    view: View, signals: Mapping[str, Array], rows: NDArray[np.int64], pace: float
) -> tuple[list[str], Array]:
    """Return the features, [N, F], and the name of each column: present, past, and value at the last reversal."""
    names, columns = [], []
    parts = slices(view.trial)
    first = np.concatenate([np.full(part.stop - part.start, part.start) for part in parts])
    late = tuple(samples(view, pace * lag_s) for lag_s in LAGS_S)
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
    seen, at = np.isfinite(values), np.arange(len(values))
    return np.interp(at, at[seen], values[seen]) if seen.any() else np.zeros(len(values))


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
