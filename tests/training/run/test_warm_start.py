"""Training on from a policy's file: exactly its weights, its normaliser, a critic of its own, an actor held still."""

from pathlib import Path

import onnx
import pytest
import torch
from onnx import numpy_helper

from softarm.policies.base import MODELS
from softarm.training.learn.network import NetworkShape
from softarm.training.learn.ppo import PpoConfig
from softarm.training.record import export
from softarm.training.record.checkpoint import CheckpointError
from softarm.training.record.settings import TrainingConfig
from softarm.training.run import warm_start
from softarm.training.run.recipe import PRESETS
from softarm.training.run.session import Session
from softarm.training.task.environment import ACTIONS, INPUTS
from softarm.training.task.reach import TASKS

SMALL = TrainingConfig(seed=3, robots=64, validate_every=2, validation_trials=8, matrix_products="float32")


def weights(model):
    return {item.name: numpy_helper.to_array(item) for item in model.graph.initializer}


@pytest.mark.parametrize("name", ["reach", "reach-wide", "shelf"])
def test_a_policy_is_read_and_exported_again_bit_for_bit(name):
    file = MODELS / f"{name}.onnx"
    prior = warm_start.load_weights(file)
    before, after = weights(onnx.load(file)), weights(export.onnx_model(prior.network))
    assert before.keys() == after.keys()
    assert len(before) > 15
    for key in before:
        assert before[key].tobytes() == after[key].tobytes(), key
    assert prior.task == PRESETS[name]
    assert prior.network.observation_normaliser.count == prior.metadata.training["run.frames"] > 1e6


@pytest.mark.slow
@pytest.mark.usefixtures("plain_pictures")
@pytest.mark.parametrize("order", ["mlp-lstm", "lstm-mlp", pytest.param("mlp", marks=pytest.mark.prove)])
def test_training_continues_from_any_order_of_layers(order, tmp_path, pool):
    shape = NetworkShape(INPUTS, ACTIONS, mlp=(16, 12), state=8, order=order)
    session = Session(TASKS["reach"], SMALL, PpoConfig(), tmp_path / "first", pool, resume=False, shape=shape)
    file = session.run(frames=64 * 16, minutes=None)
    prior = warm_start.load_weights(file)
    assert prior.network.shape == shape
    before, after = weights(onnx.load(file)), weights(export.onnx_model(prior.network))
    assert {name: each.tobytes() for name, each in before.items()} == {
        name: each.tobytes() for name, each in after.items()
    }
    again = Session(prior.task, SMALL, PpoConfig(), tmp_path / "second", pool, resume=False, shape=prior.network.shape)
    warm_start.begin(again, prior, critic_iterations=1)
    again.advance()


def test_the_critic_is_fitted_while_the_actor_is_fixed(tmp_path, pool):
    prior = warm_start.load_weights(MODELS / "reach.onnx")
    session = Session(prior.task, SMALL, PpoConfig(), tmp_path, pool, resume=False)
    fresh = {name: value.clone() for name, value in session.network.named_parameters()}
    warm_start.begin(session, prior, std=0.5, critic_iterations=3)
    learnt, given = session.network.state_dict(), prior.network.state_dict()
    for name, _ in prior.network.named_parameters():
        if name == "log_std":
            assert torch.allclose(learnt[name].exp(), torch.tensor(0.5))
        elif name.startswith("value_head"):
            assert not torch.equal(learnt[name], fresh[name]), name
        else:
            assert torch.equal(learnt[name], given[name]), name
            assert torch.equal(session.average.state_dict()[name], given[name]), name
    # Three roll-outs of 64 robots hardly move what millions of observations have settled.
    assert learnt["observation_normaliser.count"] == given["observation_normaliser.count"] + 3 * 16 * 64
    assert torch.allclose(learnt["observation_normaliser.mean"], given["observation_normaliser.mean"], atol=1e-2)
    assert session.learner.learning_rate == PpoConfig().learning_rate
    assert session.settings["start.frames"] == prior.metadata.training["run.frames"]


def test_an_invalid_policy_file_is_refused(tmp_path):
    with pytest.raises(CheckpointError, match=r"gone\.onnx: no such policy"):
        warm_start.load_weights(tmp_path / "gone.onnx")
    (tmp_path / "text.onnx").write_text("no model")
    with pytest.raises(CheckpointError, match=r"text\.onnx: not "):
        warm_start.load_weights(tmp_path / "text.onnx")
    bare = onnx.load(MODELS / "reach.onnx")
    del bare.metadata_props[:]
    onnx.save(bare, tmp_path / "bare.onnx")
    with pytest.raises(CheckpointError, match="without metadata"):
        warm_start.load_weights(tmp_path / "bare.onnx")
    other = onnx.load(MODELS / "reach.onnx")
    other.graph.initializer[0].name = "renamed"
    onnx.save(other, tmp_path / "other.onnx")
    with pytest.raises(CheckpointError, match="not a policy of `softarm train`"):
        warm_start.load_weights(Path(tmp_path / "other.onnx"))
