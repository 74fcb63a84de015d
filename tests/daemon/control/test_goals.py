import pytest

from softarm.daemon.control.goals import GoalTracker
from softarm.schemas.config import Goals
from softarm.schemas.goals import Goal

SECOND = 1_000_000_000


TARGET, MIDDLE = Goal("reach", -0.2, 0.6), Goal("reach", 0.0, 0.6)
AT, BESIDE = (-0.2, 0.6), (-0.3, 0.6)
# Goal; updates as (time in s, tip positions, state afterwards); end of the reason, closest distance and time.
FLIGHTS = {
    "reached within its radius": (
        TARGET,
        [(5, [(-0.2, 0.5)], "running"), (6, [(-0.2, 0.5601)], "reached")],
        (None, 0.0399, 1.0),
    ),
    "reached by a tip that passes before the last tick": (
        TARGET,
        [(0, [(0.0, 0.52)], "running"), (2, [(-0.1, 0.6), (-0.22, 0.6), AT, BESIDE], "reached")],
        (None, 0.02, 2.0),
    ),
    "tip positions before the goal do not count": (TARGET, [(0, [AT, BESIDE], "running")], (None, 0.1, 0.0)),
    "an unseen tip": (
        MIDDLE,
        [(0, [], "running"), (2, [], "failed")],
        ("not reached within 2.00 s: the tip was not seen, required 40 mm", None, 2.0),
    ),
    "time limit": (
        MIDDLE,
        [(0, [(0.0, 0.5)], "running"), (1, [(0.0, 0.45)], "running"), (2, [(0.0, 0.4)], "failed")],
        ("not reached within 2.00 s: closest distance 100 mm, required 40 mm", 0.1, 2.0),
    ),
    "a hold has no end of its own": (
        Goal("hold"),
        [(0, [(0.0, 0.52)], "running"), (1000, [(0.0, 0.52)], "running")],
        (None, None, 1000.0),
    ),
}


@pytest.mark.parametrize(("goal", "updates", "end"), FLIGHTS.values(), ids=FLIGHTS)
def test_a_goal_ends_by_its_radius_or_its_time_limit(goal, updates, end):
    goals = GoalTracker(Goals(time_limit_s=2.0))
    goals.start(goal)
    for t_s, tips, state in updates:
        goals.update(tips, t_s * SECOND)
        assert goals.status.state == state
    assert (goals.running is None) is (state != "running")
    assert (goals.status.reason, goals.status.closest_m, goals.status.time_s) == pytest.approx(end)


def test_a_new_goal_replaces_the_old_one():
    goals = GoalTracker(Goals())
    goals.start(Goal("reach", 0.0, 0.6))
    goals.update([(0.0, 0.59)], 0)
    goals.start(Goal("reach", -0.3, 0.7))
    assert goals.status.number == 2
    assert goals.status.closest_m is None


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
