"""Training on: the robots that it is done on lie around the model."""

import pytest

from softarm.schemas.model import Model
from softarm.simulator.effects import exemplars
from softarm.training.run.retrain import OPEN, around
from softarm.training.task.environment import Environment
from softarm.training.task.reach import TASKS


def test_robots_differ_by_what_the_model_says_and_by_what_it_leaves_open():
    model = Model()
    late = model.model_copy(update={"effects": dict(model.effects) | {"rail.delay": {"delay": 0.095}}})
    robots = around(late, 0.1)
    assert robots.each_episode
    low, high = robots.ranges["rail.delay.delay"]
    assert (low, high) == (pytest.approx(0.0855), 0.1)  # where the registry ends
    low, high = robots.ranges["rail.acceleration_limit.acceleration"]
    assert (low, high) == (pytest.approx(5.4), pytest.approx(6.6))
    assert {path: robots.ranges[path] for path in OPEN} == OPEN


def test_what_a_diagnosis_named_is_not_left_open():
    model = Model()
    effects = {"arm.stiffness": {"scale": -0.3}, "mocap.latency": {"delay": 0.04}}
    robots = around(model.model_copy(update={"effects": dict(model.effects) | effects}), 0.1)
    assert robots.ranges["arm.stiffness.scale"] == (pytest.approx(-0.33), pytest.approx(-0.27))
    assert robots.ranges["mocap.latency.delay"] == (pytest.approx(0.036), pytest.approx(0.044))


def test_without_spread_they_are_all_the_model():
    assert around(Model(), 0.0).ranges == {}


def test_every_effect_of_the_registry_can_be_spread():
    everything = Model().model_copy(update={"effects": exemplars()})
    robots = around(everything, 0.1)
    assert len(robots.ranges) >= len(exemplars())
    assert Environment(TASKS["reach"], 8, 1, everything, randomisation=robots).reset().shape == (8, 10)
