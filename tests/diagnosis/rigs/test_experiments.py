"""Next experiment of a rig: the first set that a motion separates, or the statement that no motion does."""

import numpy as np
import pytest

from softarm.diagnosis.rigs.experiments import NOTHING, between, splitting
from softarm.diagnosis.rigs.tracking import TrackingView
from tests.diagnosis.rigs.recordings import recording


@pytest.fixture(scope="module")
def view():
    t = np.arange(800) / 50
    channels = {"command": {"command": np.sin(t)}, "measured": {"position": 0.9 * np.sin(t)}}
    return TrackingView([recording("one", "sine", t, channels, ("axis", "tracking", {}))])


def test_a_set_that_no_motion_separates_says_so(view):
    found = splitting(view, [("axis.sensor_bias", "axis.rate_limit")])
    assert found.excitation == NOTHING
    assert found.separates == ("axis.sensor_bias", "axis.rate_limit")
    assert not found.expect


def test_a_set_that_a_motion_separates_comes_first(view):
    hopeless, good = ("axis.sensor_bias", "axis.rate_limit"), ("axis.deadband", "axis.lag")
    found = splitting(view, [("axis.gain",), hopeless, good])
    assert found == between(view, good)
    assert found.excitation == "a slow ramp"


def test_a_single_name_needs_no_experiment(view):
    assert splitting(view, [("axis.gain",)]) is None


def test_dead_time_and_latency_are_separated_by_a_second_sensor(view):
    found = between(view, ("axis.dead_time", "axis.latency"))
    assert "second sensor" in found.excitation
    (sign,) = set(found.expect.values())
    assert sign not in found.excitation
    assert "only their sum" in sign
