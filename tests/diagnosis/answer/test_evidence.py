"""Tests of the evidence of a stage."""

from types import SimpleNamespace

import numpy as np
import pytest

from softarm.diagnosis.answer.evidence import overlays, regimes

STEPS = 600
T = np.arange(STEPS) / 60.0
VIEW = SimpleNamespace(
    stage="arm",
    unit="m",
    channels=("y", "z"),
    t_s=T,
    trial=np.arange(STEPS) // 300,
    measured=np.stack((np.sin(T), np.full(STEPS, np.nan)), axis=1),
    regimes={"early": T < 4.0, "short": T < 1.0, "never": T < 0.0},
)


def test_a_regime_has_its_rms_and_a_short_regime_is_left_out():
    gap = np.where(VIEW.regimes["early"], 3.0, 1.0)[:, None]
    (early,) = regimes(VIEW, gap, None, least_s=2.0)
    assert (early.name, early.samples, early.patched_rms) == ("early", 240, None)
    assert early.nominal_rms == pytest.approx(3.0)
    assert [each.name for each in regimes(VIEW, gap, 0.5 * gap)] == ["early", "short"]


def test_an_overlay_is_measured_minus_gap_and_a_channel_without_samples_has_none():
    gap = np.full((STEPS, 2), 0.1)
    trials = [SimpleNamespace(name=name, kind="seed") for name in ("one", "two")]
    found = overlays(VIEW, trials, gap, 0.5 * gap, 0.1 * gap)
    assert [(each.trial, each.channel) for each in found] == [("one", "y"), ("two", "y")]
    np.testing.assert_allclose(found[1].nominal, np.sin(T[300:]) - 0.1)
    np.testing.assert_allclose(found[1].patched, np.sin(T[300:]) - 0.05)
    np.testing.assert_allclose(found[1].calibrated, np.sin(T[300:]) - 0.01)
    assert overlays(VIEW, trials, gap, None, None, channels=(1,)) == ()
