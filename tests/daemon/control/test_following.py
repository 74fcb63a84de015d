"""Check that the cart follows its set-points as the braking law allows."""

import numpy as np
import pytest

from softarm.common.braking import BrakingLaw
from softarm.daemon.control.following import TICKS, TOLERANCE_M_S, Following
from softarm.schemas.messages import RailReading

LAW = BrakingLaw(-0.24, 0.24, surge_m_s2=9.0, braking_m_s2=2.0, latency_s=0.05, hold_s=0.045, drag_m_s=0.0)
TICK_NS = 33_000_000
AGE_NS = 20_000_000  # of each reading


def watch(set_points, moved) -> Following:
    """Return the check after set-points and read velocities, one a tick, stopping once the cart is lost."""
    following, sent = Following(LAW), []
    for tick, (set_point, velocity) in enumerate(zip(set_points, moved, strict=True)):
        now_ns = tick * TICK_NS
        following.update(RailReading(now_ns - AGE_NS, 0.0, velocity, True), sent)
        sent = [*sent[-5:], (now_ns, set_point)]
        if following.is_lost:
            break
    return following


def lawful(set_points, rate_m_s2: float, latency_ticks: int) -> list[float]:
    """Return the velocities of a cart with constant acceleration and latency."""
    velocity, moved = 0.0, []
    late = [0.0] * (latency_ticks + 1) + list(set_points)
    for target in late[: len(set_points)]:
        change = rate_m_s2 * TICK_NS * 1e-9
        velocity += min(max(target - velocity, -change), change)
        moved.append(velocity)
    return moved


@pytest.mark.parametrize("latency_ticks", [0, 1])
@pytest.mark.parametrize("rate_m_s2", [2.0, 5.0, 9.0])
def test_a_cart_that_follows_as_the_law_allows_raises_nothing(rate_m_s2, latency_ticks):
    set_points = np.random.default_rng(0).choice([-1.0, -0.3, 0.0, 0.6, 1.0], 60).repeat(4)
    assert not watch(set_points, lawful(set_points, rate_m_s2, latency_ticks)).is_lost


@pytest.mark.parametrize(
    ("set_point", "velocity"),
    [(1.0, 0.0), (-0.6, 0.0), (0.0, 0.5), (-0.5, 0.5)],
    ids=["stands", "stands, the other way", "runs on", "runs the other way"],
)
def test_a_drive_that_ignores_its_set_point_is_noticed_within_half_a_second(set_point, velocity):
    set_points, moved = [0.0] * 5 + [set_point] * 25, [0.0] * 5 + [velocity] * 25
    ticks = next(end for end in range(1, 30) if watch(set_points[:end], moved[:end]).is_lost) - 5
    assert TICKS <= ticks <= 15
    assert TOLERANCE_M_S < watch(set_points, moved).error_m_s <= abs(set_point - velocity) + 1e-9


@pytest.mark.parametrize(("velocity", "lost"), [(0.76, False), (0.74, True)])
def test_a_deviation_that_the_arm_may_cause_is_no_event(velocity, lost):
    set_points = [0.0] * 5 + [1.0] * 25
    assert watch(set_points, [0.0] * 5 + [velocity] * 25).is_lost is lost


@pytest.mark.parametrize(("readings", "lost"), [(5, False), (6, True)])
def test_six_deviating_readings_in_a_row_are_an_event(readings, lost):
    following = watch([0.0] * (5 + readings), [0.0] * 5 + [0.5] * readings)
    assert (following.ticks, following.is_lost) == (readings, lost)


def test_before_the_first_reading_there_is_no_event():
    following = Following(LAW)
    assert (following.is_lost, following.error_m_s, following.ticks) == (False, 0.0, 0)


def read(following, t_ms, velocity, enabled=True, extra_ns=0):
    following.update(RailReading(t_ms * 1_000_000 + extra_ns, 0.0, velocity, enabled), [])
    return following


def test_a_repeated_reading_counts_once():
    following = read(Following(LAW), 100, 0.0)
    for t_ms in (133, 133, 133, 166):
        read(following, t_ms, 0.5)
    assert following.ticks == 2


@pytest.mark.parametrize(("later_ns", "off_m_s"), [(0, 1.0), (1, 0.0)])
def test_readings_more_than_half_a_second_apart_are_not_compared(later_ns, off_m_s):
    following = read(read(Following(LAW), 100, 0.0), 600, 1.0, extra_ns=later_ns)
    assert following.error_m_s == off_m_s
    assert following.ticks == (off_m_s > 0.0)


def test_enabling_the_drive_restarts_the_check():
    following = read(read(read(Following(LAW), 100, 0.0), 133, 0.0, enabled=False), 166, 1.0)
    assert (following.error_m_s, following.ticks) == (0.0, 0)


def test_a_missing_reading_restarts_the_check():
    following = watch([1.0] * 30, [0.0] * 30)
    assert following.is_lost
    following.update(None, [])
    assert (following.is_lost, following.error_m_s, following.ticks) == (False, 0.0, 0)
