"""Whitening of coloured residuals by an autoregression.

It is estimated once, on the residual of a rich model, and the same for all rivals. Otherwise a bad model would gain
likelihood from a wide noise model.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz

from softarm.diagnosis.engine.view import Array, View

ORDER = 5
FLOOR_SHARE = 0.3  # white noise added to each channel, in noise floors


@dataclass(frozen=True, slots=True)
class Whitener:
    """FIR filter of each channel; samples next to a gap or a trial's start become zero."""

    taps: NDArray[np.float32]  # [S, order + 1], the noise's size divided out
    keep: NDArray[np.float32]  # [M, S] 1 where the filter saw only measured samples of one trial

    def __call__(self, gap: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return a whitened gap of the same shape, [..., M, S]."""
        filled = np.nan_to_num(gap).astype(np.float32)
        white = filled * self.taps[:, 0]
        for lag in range(1, self.taps.shape[1]):
            if self.taps[:, lag].any():
                white[..., lag:, :] += filled[..., :-lag, :] * self.taps[:, lag]
        return np.asarray(white * self.keep)


def scaled(view: View, gap: Array) -> Whitener:
    """Return a scaling without a filter, by the larger of the noise floor and a fifth of the nominal gap [M, S]."""
    return unfiltered(view, np.maximum(view.floor, 0.2 * np.sqrt(np.nanmean(gap**2, axis=0))))


def unfiltered(view: View, size: Array) -> Whitener:
    """Return a scaling of each channel by its size [S], without a filter."""
    return Whitener((1 / size)[:, None].astype(np.float32), np.isfinite(view.measured).astype(np.float32))


def whitener(view: View, residual: Array) -> Whitener:
    """Fit the autoregression of a residual [M, S] (Yule-Walker), channel by channel."""
    starts = np.flatnonzero(np.diff(view.trial, prepend=-1))
    keep = np.isfinite(view.measured).astype(np.float32)
    taps = np.zeros((len(view.floor), ORDER + 1), np.float32)
    for s in range(len(view.floor)):
        r = residual[:, s]
        covariance = np.array([np.nanmean(r[lag:] * r[: len(r) - lag]) for lag in range(ORDER + 1)])
        covariance[0] += (FLOOR_SHARE * view.floor[s]) ** 2
        phi = solve_toeplitz(covariance[:-1], covariance[1:])
        innovation = max(covariance[0] - phi @ covariance[1:], 1e-3 * covariance[0])
        taps[s] = np.concatenate(([1.0], -phi)) / np.sqrt(innovation)
    for lag in range(1, ORDER + 1):
        ahead = np.ones_like(keep)
        ahead[lag:] = np.isfinite(view.measured[:-lag])
        keep *= ahead
    for start in starts:
        keep[start : start + ORDER] = 0.0
    return Whitener(taps, keep)
