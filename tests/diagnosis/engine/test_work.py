"""Plan of a search and its progress."""

import pytest

from softarm.diagnosis.engine import work


def test_a_plan_counts_one_fit_of_all_effects_and_every_removal_of_half_of_them():
    steps = [work.reduced(2, 4), work.reduced(3, 6), work.reduced(5, 10)]
    assert work.backward(5, 10) == pytest.approx(work.full(10) + sum(steps))
    assert work.backward(14, 18) > 3 * work.backward(7, 9)  # it grows with the square


def test_progress_is_the_share_of_planned_rollouts_that_are_finished():
    seen = []
    found = work.Work(lambda text, share: seen.append((text, round(share, 3))))
    found.begin("fitting", 30.0, further=70.0)
    found.count(10)
    found.count(40)  # more than planned: the step stays at its end
    found.begin("removing", 50.0, further=20.0)
    found.count(25)
    found.begin("the last", 20.0, further=0.0)  # an unfinished step counts as planned
    assert seen == [
        ("fitting", 0.0), ("fitting", 0.1), ("fitting", 0.3), ("removing", 0.3), ("removing", 0.55), ("the last", 0.8)
    ]  # fmt: skip


def test_the_share_does_not_fall_if_more_is_left_than_planned():
    seen = []
    found = work.Work(lambda text, share: seen.append(share))
    found.begin("removing", 30.0, further=30.0)
    found.count(30)
    found.begin("removing", 30.0, further=60.0)
    assert seen == [0.0, 0.5, 0.5]


def test_further_steps_stretch_the_plan():
    seen = []
    found = work.Work(lambda text, share: seen.append(share))
    found.begin("fitting", 30.0, further=10.0)
    found.begin("fitting again", 30.0, further=0.0)
    assert seen == [0.0, 0.5]
