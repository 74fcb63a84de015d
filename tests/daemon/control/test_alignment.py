"""How late the cameras are, from the cart alone: found while it moves, and never invented."""

import math

import numpy as np
import pytest

from softarm.daemon.control.alignment import Alignment, Past

MS = 1_000_000
TICK_NS = 33_333_333


def place_m(t_s):
    return 0.15 * math.sin(4.5 * t_s) + 0.04 * math.sin(11.0 * t_s)


def velocity_m_s(t_s):
    return 0.15 * 4.5 * math.cos(4.5 * t_s) + 0.04 * 11.0 * math.cos(11.0 * t_s)


def flown(late_ms=0.0, sense=1.0, offset_m=0.0, ticks=60, noise_m=0.0003, axis_slips_at=None):
    """The alignment after each tick of a swing, and the distance that it found."""
    rng, alignment = np.random.default_rng(3), Alignment()
    for tick in range(ticks):
        now_ns = tick * TICK_NS
        slip_m = 0.05 if axis_slips_at is not None and tick >= axis_slips_at else 0.0
        t_s = now_ns * 1e-9
        alignment.axis.add(now_ns, place_m(t_s) + slip_m, velocity_m_s(t_s))
        shown_ns = now_ns - 4 * MS
        seen_s = (shown_ns - late_ms * MS) * 1e-9
        apart_m = alignment.see(shown_ns, sense * place_m(seen_s) + offset_m + rng.normal(0.0, noise_m))
        yield alignment, apart_m


@pytest.mark.parametrize("late_ms", [0, 13, 46, 90, 140])
def test_the_delay_is_found_within_a_few_milliseconds_and_a_second(late_ms):
    lags_ms = [None if each.lag_ns is None else each.lag_ns / MS for each, _ in flown(late_ms)]
    assert all(lag_ms is not None for lag_ms in lags_ms[30:])
    assert [lag_ms for lag_ms in lags_ms if lag_ms is not None] == pytest.approx(
        [late_ms] * sum(lag_ms is not None for lag_ms in lags_ms), abs=6
    )


@pytest.mark.parametrize("late_ms", [0, 46, 140])
def test_no_delay_is_taken_for_a_distance_not_even_before_it_is_known(late_ms):
    assert max(apart_m for _, apart_m in flown(late_ms) if apart_m is not None) < 0.012


@pytest.mark.parametrize("late_ms", [0, 46, 140])
def test_a_frame_that_is_off_is_found_beside_any_delay(late_ms):
    apart_m = [apart_m for _, apart_m in flown(late_ms, offset_m=0.05)]
    assert max(apart_m[25:]) > 0.04


def test_an_axis_that_slips_in_mid_flight_is_found():
    found = list(flown(46, axis_slips_at=30))
    assert max(apart_m for _, apart_m in found[:30] if apart_m is not None) < 0.012
    assert min(apart_m for _, apart_m in found[36:]) > 0.03


@pytest.mark.parametrize("late_ms", [0, 46, 140])
def test_a_mirrored_frame_is_found_within_a_few_ticks_of_moving(late_ms):
    mirrored = [each.mirrored for each, _ in flown(late_ms, sense=-1.0)]
    assert mirrored.index(True) < 15
    assert all(mirrored[mirrored.index(True) :])
    assert not any(each.mirrored for each, _ in flown(late_ms))


def test_a_cart_at_rest_tells_no_delay():
    alignment, rng = Alignment(), np.random.default_rng(0)
    for tick in range(200):
        alignment.axis.add(tick * TICK_NS, 0.1, 0.0)
        assert (alignment.see(tick * TICK_NS, 0.1 + rng.normal(0.0, 0.002)) or 0.0) < 0.01
    assert alignment.lag_ns is None
    assert not alignment.mirrored


def test_an_axis_that_moves_under_a_camera_that_shows_nothing_tells_no_delay():
    alignment = Alignment()
    for tick in range(60):
        alignment.axis.add(tick * TICK_NS, place_m(tick / 30), velocity_m_s(tick / 30))
        alignment.see(tick * TICK_NS, 0.0)
    assert alignment.lag_ns is None


def test_what_the_steps_told_is_forgotten_on_request():
    *_, (alignment, _) = flown(46)
    alignment.restart()
    assert alignment.lag_ns is None


def test_a_device_is_asked_only_where_it_was_read():
    past = Past()
    assert past.at(0) is None
    for t_ms, position_m in ((100, 0.0), (140, 0.04), (140, 9.0), (120, 9.0)):  # the last two are no newer
        past.add(t_ms * MS, position_m, 1.0)
    assert past.at(99 * MS) is None
    assert past.at(110 * MS) == pytest.approx((0.01, 1.0))
    assert past.at(190 * MS) == pytest.approx((0.09, 1.0))  # carried on
    assert past.at(191 * MS) is None
