"""Words for the regime and the band in which a gap is largest."""

from types import SimpleNamespace

import numpy as np

from softarm.diagnosis.robot.decided import largest_regime


def view(samples):
    t_s = np.arange(samples) / 60.0
    return SimpleNamespace(
        stage="arm", unit="m", t_s=t_s, trial=np.zeros(samples, int), regimes={"falling": t_s > 0.75 * t_s[-1]}
    )


def test_the_regime_and_the_band_of_a_gap_are_named():
    at = view(1200)
    hum = 0.1 * np.sin(2 * np.pi * 5 * at.t_s) * (1 + 9 * at.regimes["falling"])
    assert largest_regime(at, hum[:, None]) == "falling, above 2 Hz"
    assert largest_regime(at, 0.1 * np.sin(2 * np.pi * 1 * at.t_s)[:, None]) == "throughout, from 0.5 to 2 Hz"


def test_trials_too_short_for_a_spectrum_have_no_band():
    assert largest_regime(view(100), np.ones((100, 1))) == "throughout"
