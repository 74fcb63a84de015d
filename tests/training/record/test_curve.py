"""Tests of the learning curve: the finished share, from which the remaining time follows."""

import pytest

from softarm.common.processes import left_s
from softarm.training.record.curve import Iteration, finished

STEPS, TOOK_S, VALIDATION_S, EVERY = 50_000, 1.4, 4.0, 20
STEP_S = TOOK_S + VALIDATION_S


def iterations(setup_s, frames_end, seconds_end):
    """Yield the rows and the time after each iteration of a run with an injected clock."""
    rows, now_s = [], setup_s
    while (frames_end is None or STEPS * len(rows) < frames_end) and (seconds_end is None or now_s < seconds_end):
        now_s += TOOK_S
        number = len(rows) + 1
        rows.append(Iteration(number, STEPS * number, now_s, STEPS / TOOK_S, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        if number % EVERY == 0:
            now_s += VALIDATION_S
        yield tuple(rows), now_s


@pytest.mark.parametrize("setup_s", [0.0, 12.0])
@pytest.mark.parametrize(
    ("frames_end", "seconds_end"), [(2_000_000, None), (None, 120.0), (2_000_000, 120.0), (2_000_000, 40.0)]
)
def test_the_remaining_time_holds_within_a_factor_of_two_from_the_first_tenth_on(setup_s, frames_end, seconds_end):
    """One iteration and one validation more or less are the steps in which time passes."""
    run = list(iterations(setup_s, frames_end, seconds_end))
    end_s = run[-1][1]
    checked = 0
    for rows, now_s in run:
        remaining_s = end_s - now_s
        if now_s >= 0.1 * end_s:
            estimate_s = left_s(now_s, finished(rows, now_s, frames_end, seconds_end))
            assert 0.5 * (remaining_s - STEP_S) <= estimate_s <= 2 * (remaining_s + STEP_S)
            checked += 1
    assert checked > 15


def test_a_run_without_an_iteration_has_finished_nothing_and_one_beyond_its_end_everything():
    assert finished((), 5.0, 100, None) == 0.0
    ((rows, now_s), *_) = iterations(0.0, STEPS, None)
    assert finished(rows, now_s, STEPS // 2, None) == 1.0
