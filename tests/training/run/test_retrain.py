"""Retraining: it starts from the weights of a file, and the robots vary around the model."""

from dataclasses import replace

import onnx
import pytest
import torch
from onnx import numpy_helper

from softarm.policies.base import MODELS
from softarm.schemas.model import Model
from softarm.simulator.effects import exemplars
from softarm.training.learn.network import NetworkShape
from softarm.training.learn.ppo import PpoConfig
from softarm.training.record import export
from softarm.training.record.checkpoint import CheckpointError, TrainingConfig
from softarm.training.run.recipe import PRESETS
from softarm.training.run.retrain import OPEN, RetrainingConfig, around, begin, load_weights, retrain
from softarm.training.run.session import Session
from softarm.training.task.environment import ACTIONS, INPUTS, Environment
from softarm.training.task.reach import TASKS

SMALL = TrainingConfig(seed=3, robots=16, validate_every=2, validation_trials=8, matrix_products="float32")


def weights(model):
    return {item.name: numpy_helper.to_array(item).tobytes() for item in model.graph.initializer}


@pytest.mark.parametrize("name", ["reach", "reach-wide", "shelf"])
def test_a_policy_is_read_and_exported_again_bit_for_bit(name):
    file = MODELS / f"{name}.onnx"
    prior = load_weights(file)
    before, after = weights(onnx.load(file)), weights(export.onnx_model(prior.network))
    assert before == after
    assert len(before) > 15
    assert prior.task == PRESETS[name]
    assert prior.network.observation_normaliser.count == prior.metadata.training["run.frames"] > 1e6


@pytest.mark.slow
@pytest.mark.usefixtures("plain_pictures")
@pytest.mark.parametrize("order", ["mlp-lstm", "lstm-mlp", pytest.param("mlp", marks=pytest.mark.prove)])
def test_training_continues_from_any_order_of_layers(order, tmp_path, pool):
    shape = NetworkShape(INPUTS, ACTIONS, mlp=(16, 12), state=8, order=order)
    task = replace(TASKS["reach"], episode_steps=20)
    session = Session(task, SMALL, PpoConfig(), tmp_path / "first", pool, resume=False, shape=shape)
    file = session.run(frames=16 * 16, minutes=None)
    prior = load_weights(file)
    assert prior.network.shape == shape
    assert weights(onnx.load(file)) == weights(export.onnx_model(prior.network))
    again = Session(prior.task, SMALL, PpoConfig(), tmp_path / "second", pool, resume=False, shape=prior.network.shape)
    begin(again, prior, critic_iterations=1)
    again.advance()


def test_the_critic_is_fitted_while_the_actor_is_fixed(tmp_path, pool):
    prior = load_weights(MODELS / "reach.onnx")
    session = Session(prior.task, SMALL, PpoConfig(), tmp_path, pool, resume=False)
    fresh = {name: value.clone() for name, value in session.network.named_parameters()}
    begin(session, prior, std=0.5, critic_iterations=3)
    learnt, given = session.network.state_dict(), prior.network.state_dict()
    for name, _ in prior.network.named_parameters():
        if name == "log_std":
            assert torch.allclose(learnt[name].exp(), torch.tensor(0.5))
        elif name.startswith("value_head"):
            assert not torch.equal(learnt[name], fresh[name]), name
        else:
            assert torch.equal(learnt[name], given[name]), name
            assert torch.equal(session.average.state_dict()[name], given[name]), name
    # Three roll-outs of 16 robots hardly move what millions of observations have settled.
    assert learnt["observation_normaliser.count"] == given["observation_normaliser.count"] + 3 * 16 * 16
    assert torch.allclose(learnt["observation_normaliser.mean"], given["observation_normaliser.mean"], atol=1e-2)
    assert session.learner.learning_rate == PpoConfig().learning_rate
    assert session.settings["start.frames"] == prior.metadata.training["run.frames"]


def test_an_invalid_policy_file_is_refused(tmp_path):
    with pytest.raises(CheckpointError, match=r"gone\.onnx: no such policy"):
        load_weights(tmp_path / "gone.onnx")
    (tmp_path / "text.onnx").write_text("no model")
    with pytest.raises(CheckpointError, match=r"text\.onnx: not "):
        load_weights(tmp_path / "text.onnx")
    bare = onnx.load(MODELS / "reach.onnx")
    del bare.metadata_props[:]
    onnx.save(bare, tmp_path / "bare.onnx")
    with pytest.raises(CheckpointError, match="without metadata"):
        load_weights(tmp_path / "bare.onnx")
    newer = onnx.load(MODELS / "reach.onnx")
    for each in newer.metadata_props:
        each.value = each.value.replace('"task.name"', '"task.title"')
    onnx.save(newer, tmp_path / "newer.onnx")
    with pytest.raises(CheckpointError, match=r"newer\.onnx: its task cannot be built .*title"):
        load_weights(tmp_path / "newer.onnx")
    other = onnx.load(MODELS / "reach.onnx")
    other.graph.initializer[0].name = "renamed"
    onnx.save(other, tmp_path / "other.onnx")
    untyped = onnx.load(MODELS / "reach.onnx")
    untyped.graph.initializer[0].data_type = onnx.TensorProto.UNDEFINED
    onnx.save(untyped, tmp_path / "untyped.onnx")
    for name in ("other", "untyped"):
        with pytest.raises(CheckpointError, match="not a policy of `softarm train`"):
            load_weights(tmp_path / f"{name}.onnx")


def test_robots_vary_by_the_model_s_effects_and_by_the_open_parameters():
    robots = around(Model(effects=Model().effects | {"rail.delay": {"delay": 0.095}}), 0.1)
    assert robots.each_episode
    low, high = robots.ranges["rail.delay.delay"]
    assert (low, high) == (pytest.approx(0.0855), 0.1)  # the registry's bound
    low, high = robots.ranges["rail.acceleration_limit.acceleration"]
    assert (low, high) == (pytest.approx(5.4), pytest.approx(6.6))
    assert {path: robots.ranges[path] for path in OPEN} == OPEN


def test_a_named_effect_is_not_an_open_parameter():
    effects = {"arm.stiffness": {"scale": -0.3}, "mocap.latency": {"delay": 0.04}}
    robots = around(Model(effects=Model().effects | effects), 0.1)
    assert robots.ranges["arm.stiffness.scale"] == (pytest.approx(-0.33), pytest.approx(-0.27))
    assert robots.ranges["mocap.latency.delay"] == (pytest.approx(0.036), pytest.approx(0.044))


def test_without_spread_all_robots_are_the_model():
    assert around(Model(), 0.0).ranges == {}


def test_every_effect_of_the_registry_can_vary():
    everything = Model(effects=exemplars())
    robots = around(everything, 0.1)
    assert len(robots.ranges) >= len(exemplars())
    assert Environment(TASKS["reach"], 8, 1, everything, randomisation=robots).reset().shape == (8, 10)


@pytest.mark.slow
def test_a_retraining_too_short_to_matter_is_refused_with_the_minimum(tmp_path):
    short = RetrainingConfig(seconds=0.1, robots=16, validation_trials=12, critic_iterations=1)
    with pytest.raises(ValueError, match=r"at least 0\.20 M are needed: give --seconds \d+0 or more"):
        retrain(MODELS / "reach.onnx", Model(), "seed", tmp_path, short, lambda text, share: None)
    assert not (tmp_path / "retrained.onnx").exists()
