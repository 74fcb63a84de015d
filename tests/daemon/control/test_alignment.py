"""Latency of motion capture, estimated from the moving cart."""

import math

import numpy as np
import pytest

from softarm.daemon.control.alignment import Alignment, ReadingHistory

MS = 1_000_000
TICK_NS = 33_333_333


def place_m(t_s):
    return 0.15 * math.sin(4.5 * t_s) + 0.04 * math.sin(11.0 * t_s)


def velocity_m_s(t_s):
    return 0.15 * 4.5 * math.cos(4.5 * t_s) + 0.04 * 11.0 * math.cos(11.0 * t_s)


def flown(late_ms=0.0, sense=1.0, offset_m=0.0, ticks=60, noise_m=0.0003, axis_slips_at=None):
    """Yield the alignment and its distance after each tick of a swing."""
    rng, alignment = np.random.default_rng(3), Alignment()
    for tick in range(ticks):
        now_ns = tick * TICK_NS
        slip_m = 0.05 if axis_slips_at is not None and tick >= axis_slips_at else 0.0
        t_s = now_ns * 1e-9
        alignment.axis.add(now_ns, place_m(t_s) + slip_m, velocity_m_s(t_s))
        shown_ns = now_ns - 4 * MS
        seen_s = (shown_ns - late_ms * MS) * 1e-9
        apart_m = alignment.update(shown_ns, sense * place_m(seen_s) + offset_m + rng.normal(0.0, noise_m))
        yield alignment, apart_m


@pytest.mark.parametrize("late_ms", [0, 13, 46, 90, 140])
def test_the_delay_is_found_within_a_few_milliseconds_and_a_second(late_ms):
    lags_ms = [None if each.lag_ns is None else each.lag_ns / MS for each, _ in flown(late_ms)]
    assert all(lag_ms is not None for lag_ms in lags_ms[30:])
    assert [lag_ms for lag_ms in lags_ms if lag_ms is not None] == pytest.approx(
        [late_ms] * sum(lag_ms is not None for lag_ms in lags_ms), abs=6
    )


@pytest.mark.parametrize("late_ms", [0, 46, 140])
def test_latency_is_neither_a_distance_nor_a_mirror_and_hides_none(late_ms):
    assert max(apart_m for _, apart_m in flown(late_ms) if apart_m is not None) < 0.012
    assert not any(each.mirrored for each, _ in flown(late_ms))
    assert max([apart_m for _, apart_m in flown(late_ms, offset_m=0.05)][25:]) > 0.04
    mirrored = [each.mirrored for each, _ in flown(late_ms, sense=-1.0)]
    assert mirrored.index(True) < 15
    assert all(mirrored[mirrored.index(True) :])


def test_an_axis_that_slips_in_mid_flight_is_found():
    found = list(flown(46, axis_slips_at=30))
    assert max(apart_m for _, apart_m in found[:30] if apart_m is not None) < 0.012
    assert min(apart_m for _, apart_m in found[36:]) > 0.03


def test_a_cart_at_rest_shows_no_latency():
    alignment, rng = Alignment(), np.random.default_rng(0)
    for tick in range(200):
        alignment.axis.add(tick * TICK_NS, 0.1, 0.0)
        assert (alignment.update(tick * TICK_NS, 0.1 + rng.normal(0.0, 0.002)) or 0.0) < 0.01
    assert alignment.lag_ns is None
    assert not alignment.mirrored


def test_restart_discards_the_estimate():
    *_, (alignment, _) = flown(46)
    alignment.restart()
    assert alignment.lag_ns is None


def test_a_history_interpolates_linearly_and_has_values_only_near_its_readings():
    past = ReadingHistory()
    assert past.at(0) is None
    for reading in ((100, 0.0, 0.0), (140, 0.04, 2.0), (180, 0.2, 6.0), (180, 9.0, 9.0), (120, 9.0, 9.0)):
        past.add(reading[0] * MS, *reading[1:])  # the last two are no newer
    assert past.at(100 * MS - 1) is None
    assert past.at(100 * MS) == (0.0, 0.0)
    assert past.at(110 * MS) == pytest.approx((0.01, 0.5))
    assert past.at(170 * MS) == pytest.approx((0.16, 5.0))
    assert past.at(230 * MS) == pytest.approx((0.5, 6.0))  # carried on
    assert past.at(230 * MS + 1) is None


def test_a_reading_without_a_rate_has_rate_zero():
    past = ReadingHistory()
    past.add(0, 5.0)
    assert past.at(40 * MS) == (5.0, 0.0)


@pytest.mark.parametrize(("after_ns", "kept"), [(400 * MS, True), (400 * MS + 1, False)])
def test_readings_are_kept_for_the_longest_allowed_delay(after_ns, kept):
    past = ReadingHistory()
    past.add(0, 0.1)
    past.add(after_ns, 0.2)
    assert (past.at(0) is not None) is kept


# A single step: the axis stood when a frame was seen; at the next it has gone a path (10 ms apart, newest first).


def one_step(path_m, shown_m, step_ns=200 * MS):
    """Return the alignment after one step of the cart, and its final distance from the axis."""
    alignment, now_ns = Alignment(), 200 * MS + step_ns
    for t_ms in range(0, 201, 10):
        alignment.axis.add(t_ms * MS, 0.0)
    alignment.update(200 * MS, 0.0)
    for lag in reversed(range(16)):
        alignment.axis.add(now_ns - lag * 10 * MS, (*path_m, *[0.0] * 16)[lag])
    return alignment, alignment.update(now_ns, shown_m)


def reported_ms(path_m, shown_m):
    lag_ns = one_step(path_m, shown_m)[0].lag_ns
    return None if lag_ns is None else lag_ns / MS


def passing(place, before_m, at_m, after_m):
    """Return a path through three given positions."""
    return [*[0.0] * place, before_m, at_m, after_m, *[0.0] * 15][1:17]


@pytest.mark.parametrize("place", range(16))
def test_the_delay_is_the_age_of_the_matching_axis_position(place):
    """The minimum is on a parabola through three residuals, except at either end."""
    beside_ms = 10 * 0.5 * (10**2 - 20**2) / (10**2 - 2 * 5**2 + 20**2)
    expected_ms = 10 * place + (beside_ms if 0 < place < 15 else 0.0)
    assert reported_ms(passing(place, 0.09, 0.095, 0.08), 0.1) == pytest.approx(expected_ms, abs=1e-6)


@pytest.mark.parametrize(("apart_m", "reported"), [(0.009, False), (0.011, True)])
def test_an_ambiguous_latency_is_not_reported(apart_m, reported):
    """The smallest delay wins within 30 ms; minima 60 ms apart are ambiguous."""
    speeding_up = [*[0.1 + apart_m] * 3, 0.1, 0.05]
    assert (reported_ms(speeding_up, 0.1) is not None) is reported


@pytest.mark.parametrize(("other_m", "reported"), [(0.0387, False), (0.0436, True)])
def test_a_latency_with_a_large_residual_is_not_reported(other_m, reported):
    """The squared residual of 20 mm exceeds a quarter of the next best less (10 mm)^2."""
    slowing_down = [*[0.12 - other_m] * 3, 0.1, 0.05]
    assert (reported_ms(slowing_down, 0.12) is not None) is reported


def test_the_distance_allows_ten_milliseconds_around_the_delay():
    for place in range(15):
        assert one_step(passing(place, 0.09, 0.095, 0.12), 0.1)[1] == 0.0
    alignment, apart_m = one_step([0.0, 0.2, 0.09, 0.095, 0.08, 0.2], 0.1)
    assert alignment.lag_ns == pytest.approx(30 * MS, abs=5 * MS)
    assert apart_m == pytest.approx(0.005)


def test_a_gap_in_the_frames_shows_no_latency():
    alignment = Alignment()
    for t_ms in range(0, 200, 10):
        alignment.axis.add(t_ms * MS, 0.0)
    alignment.update(190 * MS, 0.0)
    assert alignment.update(300 * MS, 0.06) is None
    alignment.axis.add(320 * MS, 0.06)
    assert alignment.update(320 * MS, 0.06) == 0.0
    assert alignment.lag_ns is None


@pytest.mark.parametrize(
    ("path_m", "shown_m", "mirrored"),
    [
        ([0.02], -0.039, True),  # against it 0.019 are left, with it 0.039
        ([0.02], -0.042, False),
        ([0.02] * 16, -0.058, True),  # 0.038 and, now that it went so at every lag, 0.078
        ([0.02] * 16, -0.064, False),
    ],
)
def test_a_mirrored_frame_needs_a_residual_below_a_quarter(path_m, shown_m, mirrored):
    assert one_step(path_m, shown_m)[0].mirrored is mirrored


@pytest.mark.parametrize(("step_ns", "mirrored"), [(400 * MS, True), (400 * MS + 1, False)])
def test_a_step_as_long_as_the_history_counts(step_ns, mirrored):
    assert one_step([0.05] * 16, -0.05, step_ns)[0].mirrored is mirrored


def crept(step_m, shown_m, axis_m):
    """Return the alignment after a mirrored step and 99 smaller steps."""
    alignment, _ = one_step([step_m] * 16, -step_m)
    for tick in range(1, 100):
        now_ns = 400 * MS + tick * TICK_NS
        alignment.axis.add(now_ns, step_m + tick * axis_m, axis_m / TICK_NS * 1e9)
        alignment.update(now_ns, -step_m + tick * shown_m)
    return alignment


@pytest.mark.parametrize(("axis_m", "remembered"), [(0.0, True), (0.0028, True), (0.0035, False)])
def test_an_old_step_is_forgotten_while_the_cart_moves_alone(axis_m, remembered):
    """A step of 3 mm in a tick counts as motion."""
    assert crept(0.05, 0.0, axis_m).mirrored is remembered


@pytest.mark.parametrize(("creeping_m", "mirrored"), [(0.0035, False), (0.0045, True)])
def test_the_estimate_covers_about_a_second(creeping_m, mirrored):
    """Steps of a mirrored frame add up to an equilibrium with forgetting: (20 mm)^2 or (26 mm)^2."""
    assert crept(0.0, -creeping_m, creeping_m).mirrored is mirrored
