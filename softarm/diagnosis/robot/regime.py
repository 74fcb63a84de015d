"""Regime and frequency band in which a stage's gap is largest, in words."""

import numpy as np

from softarm.diagnosis.answer.evidence import Gap, density, regimes, rms
from softarm.diagnosis.engine.view import View
from softarm.diagnosis.robot.trial_grid import RATE_HZ

BANDS = ((0.0, 0.5, "below 0.5 Hz"), (0.5, 2.0, "from 0.5 to 2 Hz"), (2.0, 30.0, "above 2 Hz"))
LEAST_S = 2.0  # shorter regimes are left out
CLEARLY = 1.2  # times the overall RMS


def in_words(view: View, gap: Gap) -> str:
    """Return the regime and the frequency band with the largest gap; no band if every trial is too short for one."""
    overall = rms(gap)
    frequency, amplitude = density(view, gap, RATE_HZ)
    powers = [float((amplitude[(frequency >= a) & (frequency < b)] ** 2).sum()) for a, b, _ in BANDS]
    band = BANDS[int(np.argmax(powers))][2] if sum(powers) > 0 else ""
    found = regimes(view, gap, None, LEAST_S) if overall else ()
    largest = max(((each.nominal_rms / overall, each.name) for each in found), default=(0.0, ""))
    regime = largest[1] if largest[0] > CLEARLY else "throughout"
    return f"{regime}, {band}" if band else regime
