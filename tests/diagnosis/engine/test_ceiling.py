"""Tests of the flexible model: known shares are found, and no information leaks between trials."""

import numpy as np
import pytest
from scipy.signal import lfilter

from softarm.diagnosis.engine import ceiling
from softarm.diagnosis.engine.ceiling import LAGS_S, beyond_chance, explainable, turned
from tests.diagnosis.engine.gauge import channel

pytestmark = pytest.mark.slow
STEP_S = 1 / 60
LONGEST = round(LAGS_S[-1] / STEP_S)
TRIALS, LENGTH = 4, 900
SAMPLES = TRIALS * LENGTH


def _view(length=LENGTH):
    """Return trials of one length whose features are white noise."""
    random = np.random.default_rng(0)
    features = {name: random.normal(size=SAMPLES) for name in ("input", "other")}
    return channel(SAMPLES // length, length, measured=np.zeros((SAMPLES, 1)), features=features, echoes={"state"})


def _noise(seed=1):
    return np.random.default_rng(seed).normal(size=SAMPLES)


def _share(view, residual, simulated=0.0, folds=2):
    view.measured = (simulated + residual)[:, None]
    return explainable(view, residual[:, None], view.trial % folds)


def test_noise_is_explained_by_nothing():
    share, _ = _share(_view(), _noise())
    assert share < 0.02


@pytest.mark.parametrize("lag", [0, LONGEST])
def test_a_law_of_the_present_or_of_the_past_is_found_and_its_feature_named(lag):
    view = _view()
    before = np.where(np.arange(SAMPLES) % LENGTH < lag, 0.0, np.roll(view.features["input"], lag))
    share, used = _share(view, before)
    assert share > 0.9
    assert next(iter(used)) == "input"
    assert used["input"] > 0.8


def _play(command, half):
    """Return the output of a play, which remembers the last reversal of the command."""
    seen, found = command[0], np.empty(len(command))
    for i, value in enumerate(command):
        seen = min(max(seen, value - half), value + half)
        found[i] = seen
    return found


def test_a_law_with_a_memory_without_end_is_found_by_where_its_input_turned():
    """Slow swings about wandering levels: the play's state is older than any lag, and known from the last turn."""
    view, t = _view(), np.arange(SAMPLES)
    command = np.sin(t / 60) + 0.8 * np.sin(t / 163 + 1) + 0.5 * np.sin(t / 39)
    view.features = {"input": command}
    play = np.concatenate([_play(command[k : k + LENGTH], 0.4) for k in range(0, SAMPLES, LENGTH)])
    share, _ = _share(view, play - command)
    assert share > 0.6


def test_a_law_of_the_simulated_state_is_found():
    view = _view()
    state = np.cumsum(_noise(7)) / 20
    residual = 0.3 * np.sin(state)
    share, used = _share(view, residual, state)
    assert share > 0.8
    assert next(iter(used)) == "state, simulated"


def test_measured_and_simulated_together_do_not_give_the_noise_away():
    """Their difference is the residual itself: what is noise there stays noise."""
    view, noise = _view(), _noise()
    state = 30 * np.sin(np.arange(SAMPLES) / 40)
    view.features["state"] = state + noise
    share, _ = _share(view, noise, state)
    assert share < 0.02


def test_where_a_signal_turned():
    signal = np.concatenate((np.linspace(0, 1, 11), np.linspace(1, -1, 21)[1:], np.linspace(-1, 0, 11)[1:]))
    found = turned(signal)
    assert found[5] == 0.0
    assert found[20] == pytest.approx(1.0)
    assert found[-1] == pytest.approx(-1.0)


def test_of_a_law_under_noise_the_law_s_share_of_the_energy_is_found():
    view, part = _view(), 0.3
    share, _ = _share(view, np.sqrt(part) * view.features["input"] + np.sqrt(1 - part) * _noise(), folds=4)
    assert part - 0.1 < share < part + 0.02  # trees spend a little on noise


def test_a_law_that_each_fold_has_for_itself_explains_nothing_held_out():
    view = _view()
    share, _ = _share(view, np.where(view.trial % 2 == 0, 1.0, -1.0) * view.features["input"])
    assert share == 0.0


def test_a_trial_has_no_access_to_the_end_of_another_trial():
    """Many short trials whose residual is the input of the trial before: none of them could have known it."""
    view = _view(length=LONGEST)
    residual = np.roll(view.features["input"], LONGEST)
    view.measured = residual[:, None]
    share, _ = explainable(view, residual[:, None], np.arange(SAMPLES) * 2 // SAMPLES)
    assert share < 0.02


def test_what_was_not_measured_is_left_out():
    view = _view()
    residual = view.features["input"].copy()
    residual[::7] = np.nan
    share, _ = _share(view, residual)
    assert share > 0.9


def test_a_single_fold_explains_nothing():
    view = _view()
    view.measured = view.features["input"][:, None].copy()
    assert explainable(view, view.features["input"][:, None], np.zeros(SAMPLES, dtype=np.int64)) == (0.0, {})


BLOCKS = np.arange(SAMPLES) // (SAMPLES // 40)  # of 1.5 s
HALVES, FIFTHS = BLOCKS % 2, BLOCKS % 5


def _slow(seed, share=0.98):
    """Return noise whose error lasts for many samples, with unit variance."""
    return lfilter([np.sqrt(1 - share**2)], [1.0, -share], _noise(seed))


@pytest.fixture
def few(monkeypatch):
    """Few surrogates: enough where the law is far beyond chance."""
    monkeypatch.setattr(ceiling, "SURROGATES", 2)


def test_slow_noise_that_a_flexible_model_follows_is_no_evidence():
    """Neighbouring blocks share the noise's slow error, so the model finds part of it; of surrogates as much."""
    view, residual = _view(), _slow(6, 0.998)
    view.features = {"input": _slow(1, 0.999), "other": _slow(2, 0.999)}
    view.measured = residual[:, None]
    assert explainable(view, residual[:, None], FIFTHS)[0] > 0.1
    assert beyond_chance(view, residual[:, None], FIFTHS) == 0.0


def test_a_law_under_slow_noise_is_evidence_of_its_share(few):
    view = _view()
    view.features = {"input": _slow(1), "other": _slow(2)}
    residual = 0.8 * np.sin(3 * view.features["input"]) + 0.4 * _slow(5)
    view.measured = residual[:, None]
    assert 0.4 < beyond_chance(view, residual[:, None], HALVES) < 0.9


def test_a_ripple_by_the_place_is_found_though_only_the_velocity_is_known(few):
    view = _view()
    velocity = 2 * np.sin(np.arange(SAMPLES) / 70) + 1.1 * np.sin(np.arange(SAMPLES) / 31)
    place = np.concatenate([np.cumsum(velocity[k : k + LENGTH]) for k in range(0, SAMPLES, LENGTH)])
    residual = np.sin(place / 20) + 0.1 * _noise(4)
    view.features, view.measured = {}, (velocity + residual)[:, None]
    assert beyond_chance(view, residual[:, None], HALVES) > 0.4


def test_an_empty_residual_is_no_evidence():
    assert beyond_chance(_view(), np.full((SAMPLES, 1), np.nan), FIFTHS) == 0.0
