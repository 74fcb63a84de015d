import math

import pytest

from softarm.daemon.control.goals import GoalTracker
from softarm.schemas.config import Goals
from softarm.schemas.goals import Goal

SECOND = 1_000_000_000


def test_reached_when_the_tip_is_within_the_radius():
    goals = GoalTracker(Goals())
    goals.take_up(Goal("reach", -0.2, 0.6))
    goals.update([(-0.2, 0.5)], 5 * SECOND)
    assert goals.status.state == "running"
    goals.update([(-0.2, 0.5601)], 6 * SECOND)
    assert goals.status.state == "reached"
    assert goals.status.time_s == pytest.approx(1.0)
    assert goals.status.closest_m == pytest.approx(0.0399)
    assert goals.running is None


def test_a_tip_that_passes_by_between_two_ticks_has_reached():
    goals = GoalTracker(Goals())
    goals.take_up(Goal("reach", -0.2, 0.6))
    goals.update([(0.0, 0.52)], 0)
    goals.update([(-0.1, 0.6), (-0.21, 0.6), (-0.3, 0.6)], SECOND)
    assert goals.status.state == "reached"
    assert goals.status.closest_m == pytest.approx(0.01)


def test_where_the_tip_was_before_the_goal_does_not_count():
    goals = GoalTracker(Goals())
    goals.take_up(Goal("reach", -0.2, 0.6))
    goals.update([(-0.2, 0.6), (-0.3, 0.6)], 0)
    assert goals.status.state == "running"
    assert goals.status.closest_m == pytest.approx(0.1)


def test_a_tip_that_nobody_saw_has_not_reached_and_the_reason_says_so():
    goals = GoalTracker(Goals(time_limit_s=2.0))
    goals.take_up(Goal("reach", 0.0, 0.6))
    goals.update([], 0)
    goals.update([], 2 * SECOND)
    assert goals.status.state == "failed"
    assert "the tip was not seen" in goals.status.reason


def test_fails_at_the_time_limit_and_says_how_close_it_came():
    goals = GoalTracker(Goals(time_limit_s=2.0))
    goals.take_up(Goal("reach", 0.0, 0.6))
    goals.update([(0.0, 0.5)], 0)
    goals.update([(0.0, 0.45)], SECOND)
    assert goals.status.state == "running"
    goals.update([(0.0, 0.4)], 2 * SECOND)
    assert goals.status.state == "failed"
    assert goals.status.reason == "not reached within 2.00 s; closest 100 mm, reached means within 40 mm"


def test_a_new_goal_takes_the_place_of_the_old_and_counts_on():
    goals = GoalTracker(Goals())
    goals.take_up(Goal("reach", 0.0, 0.6))
    goals.update([(0.0, 0.59)], 0)
    goals.take_up(Goal("reach", -0.3, 0.7))
    assert goals.status.number == 2
    assert goals.status.closest_m is None


def test_a_hold_has_no_end_of_its_own():
    goals = GoalTracker(Goals())
    goals.take_up(Goal("hold"))
    goals.update([(0.0, 0.52)], 0)
    goals.update([(0.0, 0.52)], 1000 * SECOND)
    assert goals.running == goals.status.goal
    assert goals.status.closest_m is None
    assert math.isnan(goals.running.y_m)


def test_failing_and_cancelling_leave_an_ended_goal_alone():
    goals = GoalTracker(Goals())
    goals.take_up(Goal("reach", 0.0, 0.6))
    goals.update([(0.0, 0.6)], 0)
    goals.fail("too late")
    goals.cancel("too late")
    assert goals.status.state == "reached"
