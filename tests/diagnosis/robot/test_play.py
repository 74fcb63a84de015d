"""A cart with play: it flies freely between the flanks and never leaves them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softarm.diagnosis.robot.play import coasting

STEP_S, HALF_M = 0.01, 0.002
TIME_S = np.arange(200) * STEP_S


def flown(way, pushed_m_s2=0.0):
    """Return the position of one cart whose drive moves along `way`, m."""
    way = np.asarray(way, float)[:, None]
    return coasting(way, np.gradient(way, STEP_S, axis=0), HALF_M, np.full_like(way, pushed_m_s2), STEP_S)[:, 0]


@given(st.floats(0.1, 20.0), st.floats(0.0, 0.2), st.floats(-20.0, 20.0))
def test_a_cart_stays_between_the_flanks(rad_s, size_m, pushed_m_s2):
    way = size_m * np.sin(rad_s * TIME_S)
    assert np.abs(flown(way, pushed_m_s2) - way).max() <= HALF_M * (1 + 1e-9)


def test_a_drive_that_stops_lets_the_cart_go_on_to_the_flank_ahead():
    way = np.minimum(0.1 * TIME_S, 0.1)
    assert flown(way)[-1] == pytest.approx(0.1 + HALF_M)


def test_a_push_carries_the_cart_to_a_flank_with_constant_acceleration():
    cart = flown(np.zeros(200), 0.1)
    steps = np.arange(1, 15)
    assert cart[:14] == pytest.approx(0.1 * STEP_S**2 * steps * (steps + 1) / 2)
    assert cart[-1] == HALF_M
