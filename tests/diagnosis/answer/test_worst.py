"""Place of the largest gap: which signal a report shows first, and which part of it."""

import numpy as np
import pytest

from softarm.diagnosis.answer.worst import window, worst
from softarm.diagnosis.engine.result import Diagnosis, Overlay
from tests.diagnosis.verdicts import gap, rms, verdict

UNITS = {"arm": "m", "pressure": "kPa"}
FLOORS = rms("m", arm=0.003) | rms("kPa", pressure=0.2)


def drawn(stage, trial, swing, gap, samples=400):
    t = np.arange(samples) / 100
    measured = swing * np.sin(t)
    return Overlay(stage, trial, "seed", stage, UNITS[stage], t, measured, measured - gap, None)


def shown_first(stage, *overlays):
    """Return the trial that the plot of a diagnosis with this stage shows first."""
    found = verdict("unknown", stage=stage, gaps=gap(floor=FLOORS))
    return overlays[worst(Diagnosis(found, None, None, (), overlays))].trial


def test_the_plot_opens_at_the_largest_gap_in_noise_floors():
    other_stage = drawn("arm", "other", 0.1, 0.02)  # seven floors
    quiet = drawn("pressure", "quiet", 0.1, 0.3)  # thrice its own swing
    calm = drawn("pressure", "calm", 20.0, 0.1)
    assert shown_first("pressure", other_stage, quiet, drawn("pressure", "worst", 10.0, 0.9), calm) == "worst"


def test_without_a_gap_the_plot_opens_at_the_signal_that_moves_most():
    noise, calm = drawn("pressure", "noise", 0.01, 0.1), drawn("arm", "calm", 0.01, 0.001)
    assert shown_first(None, noise, calm, drawn("arm", "swing", 0.3, 0.001)) == "swing"


def test_the_plot_opens_at_the_worst_two_seconds_and_shows_a_short_trial_whole():
    gap = np.where(np.abs(np.arange(6000) - 4500) < 100, 1.0, 0.001)
    start, end = window(drawn("pressure", "long", 1.0, gap, 6000))
    assert start <= 44.01
    assert 45.99 <= end == pytest.approx(start + 2.0)
    assert window(drawn("pressure", "short", 1.0, 0.1, 200)) is None
