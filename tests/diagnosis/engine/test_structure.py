"""Is what is left noise? Rarely found in noise, found wherever something is missing."""

import numpy as np
import pytest

from softarm.diagnosis.engine.structure import structure
from tests.diagnosis.engine.gauge import channel

TRIALS, LENGTH, STEP_S = 4, 900, 1 / 60
SAMPLES = TRIALS * LENGTH
T = STEP_S * (np.arange(SAMPLES) % LENGTH)


REGIMES = {"moving": np.sin(T) > 0.8, "rare": np.arange(SAMPLES) < 30}
KINDS = ("steps", "steps", "chirp", "chirp")


def _look(residual):
    return structure(channel(TRIALS, LENGTH, regimes=REGIMES), residual[:, None], KINDS)


def _noise(seed):
    return np.random.default_rng(seed).normal(size=SAMPLES)


@pytest.mark.parametrize(
    ("law", "where"),
    [
        (0.8 * np.sin(2 * np.pi * 1.7 * T), ""),
        (np.where(np.sin(T) > 0.8, 1.0, 0.0), "moving"),
        (0.16 * T - 1.2, ""),
        (np.where(np.arange(SAMPLES) >= SAMPLES // 2, np.sin(4 * T), 0.0), "steps"),
    ],
    ids=["a hum", "an offset in one regime", "a drift", "one kind alone"],
)
def test_a_missing_law_has_structure(law, where):
    found = _look(law + _noise(3))
    assert found.energy > 0.2
    if where == "steps":
        assert "chirp" in found.where
    elif where:
        assert where in found.where


def test_its_energy_is_the_law_s():
    found = _look(2.0 * np.sin(2 * np.pi * 0.4 * T) + _noise(4))
    assert 1.5 < found.energy < 5.0  # 2 throughout; more where it is strongest


def test_missing_samples_show_no_structure():
    residual = _noise(5)
    residual[::3] = np.nan
    assert _look(residual).energy == 0
