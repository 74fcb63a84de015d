"""What to record next of a rig: the first set that anything separates, else that nothing does."""

import numpy as np
import pytest

from softarm.diagnosis.rigs.experiments import NOTHING, between, splitting
from softarm.diagnosis.rigs.views import RigView
from softarm.diagnosis.rigs.vocabulary import effects


@pytest.fixture(scope="module")
def view():
    t = np.arange(100) / 50
    return RigView(
        "axis", "rad", ("position",), effects("tracking", "axis", "rad"), [t], [np.sin(t)[:, None]], 1e-3, [{"t": t}]
    )


def test_a_set_without_a_motion_says_so(view):
    found = splitting(view, [("axis.sensor_bias", "axis.rate_limit")])
    assert found.excitation == NOTHING
    assert found.separates == ("axis.sensor_bias", "axis.rate_limit")
    assert not found.expect


def test_of_several_sets_one_that_a_motion_separates_comes_first(view):
    hopeless, good = ("axis.sensor_bias", "axis.rate_limit"), ("axis.deadband", "axis.lag")
    found = splitting(view, [("axis.gain",), hopeless, good])
    assert found == between(view, good)
    assert found.excitation == "a slow ramp"


def test_a_name_alone_asks_for_nothing(view):
    assert splitting(view, [("axis.gain",)]) is None
