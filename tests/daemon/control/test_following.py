"""A drive that does not do what it was told is noticed; one that does as the braking law allows never is."""

import numpy as np
import pytest

from softarm.common.braking import BrakingLaw
from softarm.daemon.control.following import TICKS, TOLERANCE_M_S, Following
from softarm.schemas.messages import RailReading

LAW = BrakingLaw(-0.24, 0.24, surge_m_s2=9.0, braking_m_s2=2.0, latency_s=0.05, hold_s=0.045, drag_m_s=0.0)
TICK_NS = 33_000_000
AGE_NS = 20_000_000  # of each reading


def watch(told, moved, enabled=True, skipped=()) -> Following:
    """What is made of set-points, one a tick, and of the velocities that were read; it stops where it is lost."""
    following, sent = Following(LAW), []
    for tick, (set_point, velocity) in enumerate(zip(told, moved, strict=True)):
        if tick in skipped:
            continue
        now_ns = tick * TICK_NS
        following.update(RailReading(now_ns - AGE_NS, 0.0, velocity, enabled), sent)
        sent = [*sent[-5:], (now_ns, set_point)]
        if following.lost:
            break
    return following


def lawful(told, rate_m_s2: float, latency_ticks: int) -> list[float]:
    """The velocities of a cart that follows with one acceleration and one latency."""
    velocity, moved = 0.0, []
    late = [0.0] * (latency_ticks + 1) + list(told)
    for target in late[: len(told)]:
        change = rate_m_s2 * TICK_NS * 1e-9
        velocity += min(max(target - velocity, -change), change)
        moved.append(velocity)
    return moved


@pytest.mark.parametrize("latency_ticks", [0, 1])
@pytest.mark.parametrize("rate_m_s2", [2.0, 5.0, 9.0])
def test_a_cart_that_follows_as_the_law_allows_raises_nothing(rate_m_s2, latency_ticks):
    told = np.random.default_rng(0).choice([-1.0, -0.3, 0.0, 0.6, 1.0], 60).repeat(4)
    assert not watch(told, lawful(told, rate_m_s2, latency_ticks)).lost


@pytest.mark.parametrize(
    ("set_point", "velocity"),
    [(1.0, 0.0), (-0.6, 0.0), (0.0, 0.5), (-0.5, 0.5)],
    ids=["stands", "stands, the other way", "runs on", "runs the other way"],
)
def test_a_drive_that_ignores_its_set_point_is_noticed_within_half_a_second(set_point, velocity):
    told, moved = [0.0] * 5 + [set_point] * 25, [0.0] * 5 + [velocity] * 25
    ticks = next(end for end in range(1, 30) if watch(told[:end], moved[:end]).lost) - 5
    assert TICKS <= ticks <= 15
    assert TOLERANCE_M_S < watch(told, moved).off_m_s <= abs(set_point - velocity) + 1e-9


@pytest.mark.parametrize(("velocity", "lost"), [(0.76, False), (0.74, True)])
def test_less_than_an_arm_may_drag_is_nothing(velocity, lost):
    told = [0.0] * 5 + [1.0] * 25
    assert watch(told, [0.0] * 5 + [velocity] * 25).lost is lost


@pytest.mark.parametrize(("readings", "lost"), [(5, False), (6, True)])
def test_six_readings_in_a_row_are_no_accident(readings, lost):
    following = watch([0.0] * (5 + readings), [0.0] * 5 + [0.5] * readings)
    assert (following.ticks, following.lost) == (readings, lost)


def test_before_the_first_reading_nothing_is_lost():
    following = Following(LAW)
    assert (following.lost, following.off_m_s, following.ticks) == (False, 0.0, 0)


def read(following, t_ms, velocity, enabled=True, extra_ns=0, sent=()):
    following.update(RailReading(t_ms * 1_000_000 + extra_ns, 0.0, velocity, enabled), sent)
    return following


def test_a_reading_that_comes_twice_counts_once():
    following = read(Following(LAW), 100, 0.0)
    for t_ms in (133, 133, 133, 166):
        read(following, t_ms, 0.5)
    assert following.ticks == 2


@pytest.mark.parametrize(("later_ns", "off_m_s"), [(0, 1.0), (1, 0.0)])
def test_readings_half_a_second_apart_say_something_of_each_other_and_no_further(later_ns, off_m_s):
    following = read(read(Following(LAW), 100, 0.0), 600, 1.0, extra_ns=later_ns)
    assert following.off_m_s == off_m_s
    assert following.ticks == (off_m_s > 0.0)


def test_a_drive_that_was_off_in_between_begins_anew():
    following = read(read(read(Following(LAW), 100, 0.0), 133, 0.0, enabled=False), 166, 1.0)
    assert (following.off_m_s, following.ticks) == (0.0, 0)


def test_a_set_point_is_as_old_as_it_is():
    """Not renewed for 0.3 s: the link lets it act for 45 ms, and 50 later the cart brakes with 2 m/s^2 at least."""
    following = Following(LAW)
    for t_ms in range(0, 331, 33):
        read(following, t_ms, 0.8 if t_ms else 0.0, sent=[(at * 1_000_000, 0.8) for at in range(0, t_ms, 33)])
    last_sent = [(at * 1_000_000, 0.8) for at in range(0, 331, 33)]
    read(following, 630, 0.8, sent=last_sent)
    assert following.off_m_s == pytest.approx(2.0 * (0.3 - 0.045 - 0.05))


def test_a_short_lapse_is_nothing():
    """Fewer ticks than count, again and again."""
    told = [0.8] * 60
    moved = lawful(told, 5.0, 0)
    for tick in range(20, 60):
        if tick % TICKS:
            moved[tick] = 0.0
    assert not watch(told, moved).lost


def test_a_drive_that_is_off_is_told_nothing():
    assert not watch([1.0] * 30, [0.0] * 30, enabled=False).lost


def test_skipped_ticks_let_the_link_brake():
    """Told to run, not renewed for a third of a second: a cart that stands by then is in order."""
    told = [0.8] * 40
    following = watch(told, [0.8 if tick < 20 else 0.0 for tick in range(40)], skipped=range(20, 32))
    assert following.ticks < TICKS
    assert watch(told, [0.8 if tick < 20 else 0.0 for tick in range(40)]).lost


def test_without_a_reading_it_begins_anew():
    following = watch([1.0] * 30, [0.0] * 30)
    assert following.lost
    following.update(None, [])
    assert (following.lost, following.off_m_s, following.ticks) == (False, 0.0, 0)
