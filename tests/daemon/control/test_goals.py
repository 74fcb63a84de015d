import math

import pytest

from softarm.daemon.control.goals import GoalTracker
from softarm.schemas.config import Goals
from softarm.schemas.goals import Goal

SECOND = 1_000_000_000


def test_a_goal_is_reached_within_its_radius():
    goals = GoalTracker(Goals())
    goals.start(Goal("reach", -0.2, 0.6))
    goals.update([(-0.2, 0.5)], 5 * SECOND)
    assert goals.status.state == "running"
    goals.update([(-0.2, 0.5601)], 6 * SECOND)
    assert goals.status.state == "reached"
    assert goals.status.time_s == pytest.approx(1.0)
    assert goals.status.closest_m == pytest.approx(0.0399)
    assert goals.running is None


def test_a_tip_that_passes_the_target_before_the_last_tick_reaches_it():
    goals = GoalTracker(Goals(time_limit_s=2.0))
    goals.start(Goal("reach", -0.2, 0.6))
    goals.update([(0.0, 0.52)], 0)
    goals.update([(-0.1, 0.6), (-0.22, 0.6), (-0.2, 0.6), (-0.3, 0.6)], 2 * SECOND)
    assert (goals.status.state, goals.status.reason) == ("reached", None)
    assert goals.status.closest_m == pytest.approx(0.02)


def test_tip_positions_before_the_goal_do_not_count():
    goals = GoalTracker(Goals())
    goals.start(Goal("reach", -0.2, 0.6))
    goals.update([(-0.2, 0.6), (-0.3, 0.6)], 0)
    assert goals.status.state == "running"
    assert goals.status.closest_m == pytest.approx(0.1)


def test_an_unseen_tip_fails_the_goal_with_that_reason():
    goals = GoalTracker(Goals(time_limit_s=2.0))
    goals.start(Goal("reach", 0.0, 0.6))
    goals.update([], 0)
    goals.update([], 2 * SECOND)
    assert goals.status.state == "failed"
    assert "the tip was not seen" in goals.status.reason


def test_a_goal_fails_at_the_time_limit_with_the_closest_distance():
    goals = GoalTracker(Goals(time_limit_s=2.0))
    goals.start(Goal("reach", 0.0, 0.6))
    goals.update([(0.0, 0.5)], 0)
    goals.update([(0.0, 0.45)], SECOND)
    assert goals.status.state == "running"
    goals.update([(0.0, 0.4)], 2 * SECOND)
    assert goals.status.state == "failed"
    assert goals.status.reason == "not reached within 2.00 s: closest distance 100 mm, required 40 mm"


def test_a_new_goal_replaces_the_old_one():
    goals = GoalTracker(Goals())
    goals.start(Goal("reach", 0.0, 0.6))
    goals.update([(0.0, 0.59)], 0)
    goals.start(Goal("reach", -0.3, 0.7))
    assert goals.status.number == 2
    assert goals.status.closest_m is None


def test_a_hold_has_no_end_of_its_own():
    goals = GoalTracker(Goals())
    goals.start(Goal("hold"))
    goals.update([(0.0, 0.52)], 0)
    goals.update([(0.0, 0.52)], 1000 * SECOND)
    assert goals.running == goals.status.goal
    assert goals.status.closest_m is None
    assert math.isnan(goals.running.y_m)


TICK = SECOND // 30


def flown(goals, ticks, tip=(0.0, 0.5), start=0):
    """Return the states after each tick at 30 Hz, stamped in whole nanoseconds."""
    states = []
    for tick in range(ticks):
        goals.update([tip], start + tick * TICK)
        states.append(goals.status.state)
    return states


@pytest.mark.parametrize("goal", [Goal("reach", 0.0, 0.6), Goal("hold")])
def test_the_end_of_the_policys_episode_reaches_no_target_and_ends_no_hold(goal):
    goals = GoalTracker(Goals(time_limit_s=100))
    goals.start(goal, run_s=10 / 30)
    assert set(flown(goals, 100)) == {"running"}


def test_every_goal_has_its_own_time_and_episode():
    goals = GoalTracker(Goals())
    goals.start(Goal("run"), run_s=10 / 30)
    flown(goals, 5)
    goals.start(Goal("run"), run_s=10 / 30)
    assert flown(goals, 11, start=5 * TICK) == ["running"] * 10 + ["reached"]
    assert (goals.status.reason, goals.status.closest_m) == (None, None)
    goals.start(Goal("run"))
    assert set(flown(goals, 300, start=99 * TICK)) == {"running"}


def test_without_a_goal_no_result_changes():
    goals = GoalTracker(Goals())
    before = goals.status
    goals.update([(0.0, 0.5)], SECOND)
    goals.end("failed", "nothing to fail")
    assert goals.status == before


@pytest.mark.parametrize("state", ["failed", "cancelled"])
def test_an_ended_goal_keeps_state_reason_and_time(state):
    goals = GoalTracker(Goals())
    goals.start(Goal("reach", 0.0, 0.6))
    flown(goals, 4)
    goals.end(state, "because")
    assert (goals.status.state, goals.status.reason) == (state, "because")
    assert goals.running is None
    goals.update([(0.0, 0.6)], SECOND)
    goals.end("failed", "too late")
    assert (goals.status.state, goals.status.reason) == (state, "because")
    assert goals.status.time_s == pytest.approx(0.1)
