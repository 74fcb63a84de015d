"""The time to a level: it counts when it is held."""

import pytest

from softarm.benchmarks import training as measurement
from softarm.schemas.flights import Shares
from softarm.training.learn.inference import workers
from softarm.training.run.recipe import Recipe, begin


def test_a_level_counts_from_where_it_is_held_for_three_more():
    assert measurement.first_held([True, False, True, True, True, True]) == 2
    assert measurement.first_held([True, True, True, False, True, True, True]) is None
    assert measurement.first_held([True, True, True]) is None
    assert measurement.first_held([]) is None


def test_the_level_is_the_papers_in_all_three_figures():
    assert measurement.is_at_level(Shares(0.94, 0.50, 0.80))
    for worse in ((0.93, 0.9, 0.9), (0.99, 0.49, 0.9), (0.99, 0.9, 0.79)):
        assert not measurement.is_at_level(Shares(*worse))


@pytest.mark.slow
def test_a_run_is_followed_validation_by_validation_to_its_end(tmp_path):
    settings = {"run.robots": 16, "run.validate_every": 2, "run.validation_trials": 12}
    with workers(1) as pool:
        points = measurement.follow(
            lambda: begin(Recipe(settings=settings), 1, tmp_path, pool, resume=False), pool, frames_most=1024
        )
    assert [point.frames for point in points] == [512, 1024]
    assert 0.0 < points[0].seconds < points[1].seconds
