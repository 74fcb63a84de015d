"""The dead reckoning of the tip: its error against holding the last frame, and its declared deviation."""

import pytest

from benchmarks import bridging


@pytest.mark.slow
def test_the_models_error_is_a_tenth_of_holding_the_last_frame(monkeypatch):
    monkeypatch.setattr(bridging, "METHODS", ("hold", "model"))
    monkeypatch.setattr(bridging, "TEST_TARGETS", bridging.TEST_TARGETS[::9])
    off = bridging.errors(bridging.SIMULATOR)
    for hold_m, model_m in zip(off["hold"], off["model"], strict=True):
        assert model_m < 0.1 * hold_m
    assert off["model"][-1] < 0.015  # after 167 ms


@pytest.mark.prove
def test_robots_differ_from_the_model_within_the_declared_bounds():
    """Compare the reported deviation of the tip with the true one on a robot with an unknown payload."""
    off = bridging.errors("payload")["model"]
    for tick, rms_m in enumerate(off, 1):
        assert rms_m < 1.2 * bridging.TipModel().deviation_m(tick * bridging.CONTROL_PERIOD_S)
