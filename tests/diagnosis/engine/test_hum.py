"""Hum: a steady line is found with its share of the energy; noise of any colour and short swings have none."""

import numpy as np
import pytest
from scipy.signal import lfilter

from softarm.diagnosis.engine.ceiling import hum
from tests.diagnosis.engine.gauge import channel

TRIALS, LENGTH, STEP_S = 4, 450, 1 / 60
T = STEP_S * np.arange(TRIALS * LENGTH)


def found(residual, length=LENGTH):
    return hum(channel(len(T) // length, length), residual[:, None])


def noise(seed, memory=0.0):
    return lfilter([np.sqrt(1 - memory**2)], [1, -memory], np.random.default_rng(seed).normal(size=len(T)))


@pytest.mark.parametrize("memory", [0.0, 0.9, 0.995])
def test_noise_has_no_hum(memory):
    assert sum(found(noise(seed, memory)) > 0 for seed in range(20)) <= 2


def test_a_hum_is_found_with_its_share():
    line = np.sqrt(2) * np.sin(2 * np.pi * 1.03 * T)
    assert found(line + noise(1)) == pytest.approx(0.5, abs=0.06)
    assert found(3 * line + noise(2, 0.98)) == pytest.approx(0.9, abs=0.05)


def test_a_swing_of_a_few_periods_in_each_window_is_no_hum():
    swing = np.sin(2 * np.pi * 1.03 * T)
    assert found(swing + 0.1 * noise(3), length=180) == 0.0
    assert found(swing + 0.1 * noise(3)) > 0.9


def test_a_short_residual_has_no_hum():
    assert found(noise(4), length=20) == 0.0
