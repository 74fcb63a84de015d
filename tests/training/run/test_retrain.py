"""Retraining: its robots vary around the model, and a run that is too short is refused."""

import pytest

from softarm.policies.base import MODELS
from softarm.schemas.model import Model
from softarm.simulator.effects import exemplars
from softarm.training.run.retrain import OPEN, RetrainingConfig, around, retrain
from softarm.training.task.environment import Environment
from softarm.training.task.reach import TASKS


def test_robots_vary_by_the_model_s_effects_and_by_the_open_parameters():
    model = Model()
    late = model.model_copy(update={"effects": dict(model.effects) | {"rail.delay": {"delay": 0.095}}})
    robots = around(late, 0.1)
    assert robots.each_episode
    low, high = robots.ranges["rail.delay.delay"]
    assert (low, high) == (pytest.approx(0.0855), 0.1)  # the registry's bound
    low, high = robots.ranges["rail.acceleration_limit.acceleration"]
    assert (low, high) == (pytest.approx(5.4), pytest.approx(6.6))
    assert {path: robots.ranges[path] for path in OPEN} == OPEN


def test_a_named_effect_is_not_an_open_parameter():
    model = Model()
    effects = {"arm.stiffness": {"scale": -0.3}, "mocap.latency": {"delay": 0.04}}
    robots = around(model.model_copy(update={"effects": dict(model.effects) | effects}), 0.1)
    assert robots.ranges["arm.stiffness.scale"] == (pytest.approx(-0.33), pytest.approx(-0.27))
    assert robots.ranges["mocap.latency.delay"] == (pytest.approx(0.036), pytest.approx(0.044))


def test_without_spread_all_robots_are_the_model():
    assert around(Model(), 0.0).ranges == {}


def test_every_effect_of_the_registry_can_vary():
    everything = Model().model_copy(update={"effects": exemplars()})
    robots = around(everything, 0.1)
    assert len(robots.ranges) >= len(exemplars())
    assert Environment(TASKS["reach"], 8, 1, everything, randomisation=robots).reset().shape == (8, 10)


@pytest.mark.slow
def test_a_retraining_too_short_to_matter_is_refused_with_the_minimum(tmp_path):
    short = RetrainingConfig(seconds=0.1, robots=64, validation_trials=12, critic_iterations=1)
    with pytest.raises(ValueError, match=r"at least 0\.20 M are needed: give --seconds \d+0 or more"):
        retrain(MODELS / "reach.onnx", Model(), "seed", tmp_path, short, lambda text, share: None)
    assert not (tmp_path / "retrained.onnx").exists()
