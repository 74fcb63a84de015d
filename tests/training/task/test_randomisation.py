"""Robots that differ: each has its own values, within the ranges, and a run that is resumed has the same ones."""

import numpy as np
import pytest

from softarm.simulator.effects import EffectError
from softarm.training.run.recipe import RECIPES, prepare
from softarm.training.task.environment import Randomisation, environment_of
from softarm.training.task.reach import TASKS

REACH = TASKS["reach"]
PAYLOAD = {"arm.payload.mass": (0.01, 0.05)}


def test_each_robot_has_a_separate_value_within_the_range():
    values = Randomisation(PAYLOAD).draw(np.random.default_rng(0), 200)["arm.payload.mass"]
    assert values.shape == (200,)
    assert 0.01 <= values.min() < 0.015
    assert 0.045 < values.max() <= 0.05


def test_values_are_drawn_once_or_in_each_episode():
    for each_episode in (False, True):
        environment = environment_of(REACH, 32, 1, randomisation=Randomisation(PAYLOAD, each_episode))
        environment.reset()
        environment.stagger()
        before = environment.simulator.effects.value("arm.payload", "mass")
        ended = np.zeros(32, dtype=np.bool_)
        for action in np.random.default_rng(0).uniform(-1, 1, (30, 32, 2)):
            step = environment.step(action.astype(np.float32))
            ended |= step.terminated | step.truncated
        changed = environment.simulator.effects.value("arm.payload", "mass") != before
        assert 0 < ended.sum() < 32
        assert np.array_equal(changed, ended if each_episode else np.zeros(32, dtype=np.bool_))


def test_sensors_and_clocks_are_drawn_too():
    environment = environment_of(REACH, 8, 0, randomisation=Randomisation({"mocap.offset.y": (0.02, 0.03)}))
    environment.reset()
    observation = environment.step(np.zeros((8, 2), dtype=np.float32)).observation
    offset = observation[:, 0] - environment.simulator.cart_position_m
    assert np.all((offset > 0.019) & (offset < 0.031))
    assert environment_of(REACH, 8, 0, randomisation=Randomisation({"clock.jitter.sigma": (0.0, 0.01)})).clock


@pytest.mark.parametrize(
    ("ranges", "error", "words"),
    [
        ({"arm.paylod.mass": (0, 1)}, EffectError, "arm.payload"),
        ({"arm.payload.mass": (0, 9.0)}, EffectError, "0.5"),
        ({"arm.payload.mass": (0.2, 0.1)}, ValueError, "a lower and a higher"),
    ],
)
def test_an_invalid_range_is_refused(ranges, error, words):
    with pytest.raises(error, match=words):
        Randomisation(ranges)


def test_the_robust_recipe_includes_the_seeds_robot():
    randomisation = prepare(RECIPES["reach-robust"], 1).randomisation
    assert randomisation.each_episode
    low, high = randomisation.ranges["rail.delay.delay"]
    assert low < 1 / 30 < high
    assert randomisation.ranges["arm.payload.mass"][0] == 0.0
