"""Evidence of one stage: overlays, spectra and regimes of its gaps without and with the named effects."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

from softarm.diagnosis.data.trials import Trial
from softarm.diagnosis.engine.result import Overlay, Regime, Spectrum
from softarm.diagnosis.engine.view import Array, View
from softarm.diagnosis.engine.whitened import samples

Gap = NDArray[np.floating]  # measured minus simulated, [M, S]
SEGMENT = 128  # samples of a spectrum's segments


def rms(values: Gap) -> float:
    """Return the root mean square of the values that are not NaN."""
    return float(np.sqrt(np.nanmean(np.asarray(values, dtype=float) ** 2)))


def overlays(
    view: View,
    trials: Sequence[Trial],
    before: Gap,
    after: Gap | None,
    calibrated: Gap | None,
    channels: Sequence[int] | None = None,
) -> tuple[Overlay, ...]:
    """Return measured, nominal, patched and calibrated signals of every trial, by default of all channels.

    The gaps are those of the nominal model, with the named effects, and with the calibration as well; None for none.
    """
    found = []
    for k, trial in enumerate(trials):
        rows = view.trial == k
        for s in range(len(view.channels)) if channels is None else channels:
            measured = view.measured[rows, s]
            if np.isfinite(measured).any():
                simulated = [None if gap is None else measured - gap[rows, s] for gap in (after, calibrated)]
                labels = view.stage, trial.name, trial.kind, view.channels[s], view.unit
                found.append(Overlay(*labels, view.t_s[rows], measured, measured - before[rows, s], *simulated))
    return tuple(found)


def spectrum(view: View, before: Gap, after: Gap | None, rate_hz: float) -> Spectrum:
    """Return the amplitude densities of the residuals over all trials and channels."""
    frequency, nominal = density(view, before, rate_hz)
    patched = None if after is None else density(view, after, rate_hz)[1]
    floor = float(np.sqrt(np.mean(view.floor**2) / (rate_hz / 2)))
    return Spectrum(view.stage, view.unit, frequency, nominal, patched, floor)


def density(view: View, gap: Gap, rate_hz: float) -> tuple[Array, Array]:
    """Return frequencies, Hz, and the amplitude density of a residual; both empty for short trials."""
    powers, frequency = [], np.zeros(0)
    for k in np.unique(view.trial):
        part = np.nan_to_num(gap[view.trial == k])
        if len(part) >= SEGMENT:
            frequency, power = welch(part, fs=rate_hz, nperseg=SEGMENT, axis=0)
            powers.append(power.mean(axis=1))
    return frequency, np.sqrt(np.mean(powers, axis=0)) if powers else np.zeros(0)


def regimes(view: View, before: Gap, after: Gap | None, least_s: float = 0.0) -> tuple[Regime, ...]:
    """Return the gap in every part of the data that is longer than `least_s`."""
    least = samples(view, least_s) if least_s else 0
    return tuple(
        Regime(
            view.stage,
            name,
            int(mask.sum()),
            rms(before[mask]),
            None if after is None else rms(after[mask]),
            view.unit,
        )
        for name, mask in view.regimes.items()
        if mask.sum() > least and np.isfinite(before[mask]).any()
    )
