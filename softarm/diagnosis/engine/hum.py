"""Hum: a disturbance of one frequency, which depends on no signal and so is found by no model of the signals."""

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.view import View
from softarm.diagnosis.engine.whitened import slices

LEVEL = 0.05  # share of residuals without a hum in which one is found
CYCLES_LEAST = 5.0  # in the longest trial; a window of a swing holds four periods of its own
NEIGHBOURS = 20  # frequencies on either side that show the level of the noise
WIDTH = 4  # frequencies on either side that hold a line, with a Hann window and twice its length


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
    if len(power) <= 2 * NEIGHBOURS:
        return 0.0
    around = [np.median(power[max(k - NEIGHBOURS, 0) : k + NEIGHBOURS + 1]) for k in range(len(power))]
    ratio = power / np.maximum(around, 1e-30)
    peak = WIDTH + int(np.argmax(ratio[WIDTH:]))
    if peak < 2 * CYCLES_LEAST or ratio[peak] <= np.log2(len(ratio) / LEVEL):
        return 0.0
    return float(power[peak - WIDTH : peak + WIDTH + 1].sum() / power.sum())
