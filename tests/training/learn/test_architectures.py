"""The seed's three architectures and its arm without a muscle, from learning to the file."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from softarm.policies.onnx_policy import OnnxPolicy
from softarm.schemas.policy import OBSERVATION
from softarm.training.learn.inference import infer
from softarm.training.learn.network import NetworkShape, PolicyNetwork
from softarm.training.learn.ppo import Ppo, PpoConfig
from softarm.training.record.checkpoint import TrainingConfig
from softarm.training.run.session import Session
from softarm.training.task.environment import Environment
from softarm.training.task.reach import TASKS

ORDERS = ("mlp-lstm", "lstm-mlp", "mlp")
SMALL = TrainingConfig(seed=3, robots=16, validate_every=2, validation_trials=12)
VENTED = 2 * 0.7 / 20.7 - 1.0


def network(order: str) -> PolicyNetwork:
    torch.manual_seed(1)
    made = PolicyNetwork(NetworkShape(order=order))
    made.observation_normaliser.update(3.0 * torch.randn(200, 10) + 1.0)
    return made


@pytest.mark.parametrize("order", ORDERS)
def test_only_an_lstm_remembers(order, pool):
    made = network(order)
    state = made.initial_state(1)
    first, _, state = infer(made, torch.ones(1, 10), torch.ones(1), state, pool)
    infer_again, _, _ = infer(made, torch.ones(1, 10), torch.ones(1), state, pool)
    assert torch.equal(first, infer_again) == (order == "mlp")


@pytest.mark.slow
@pytest.mark.parametrize("order", ORDERS)
def test_all_weights_learn(order, pool):
    made = network(order)
    before = {name: weight.detach().clone() for name, weight in made.named_parameters()}
    Ppo(made, Environment(TASKS["reach"], 16, 0), PpoConfig(horizon=8), pool, 0).iterate()
    assert [name for name, weight in made.named_parameters() if torch.equal(weight, before[name])] == []


def test_an_unknown_order_is_refused():
    with pytest.raises(ValueError, match="mlp-lstm, lstm-mlp, mlp"):
        NetworkShape(order="gru")


@pytest.mark.parametrize("sizes", [{"inputs": 2**31}, {"state": 0}, {"mlp": (16, 5000)}, {"mlp": (1,) * 9}])
def test_sizes_that_no_memory_holds_are_refused(sizes):
    with pytest.raises(ValueError, match="allowed are 1 to 4096 each, and 8 layers"):
        NetworkShape(**sizes)


def test_observation_noise_affects_the_learner_alone(pool):
    seen = {}
    for noise in (0.0, 0.1):
        learner = Ppo(network("mlp"), Environment(TASKS["reach"], 8, 0), PpoConfig(observation_noise=noise), pool, 0)
        observation = torch.zeros(8, 10)
        seen[noise] = learner._noisy(observation) / learner.network.observation_normaliser.scale()
    assert torch.equal(seen[0.0], torch.zeros(8, 10))
    assert 0.06 < float(seen[0.1].std()) < 0.14


@pytest.mark.slow
@pytest.mark.usefixtures("plain_pictures")
def test_without_a_muscle_the_pressure_stays_zero_in_training_and_file(tmp_path, pool):
    task = replace(TASKS["reach"], muscle=False, episode_steps=20)
    environment = Environment(task, 8, 0)
    environment.reset()
    for _ in range(10):
        environment.step(np.ones((8, 2), dtype=np.float32))
        assert np.array_equal(environment.simulator.pressure_kpa, np.zeros(8))
    session = Session(task, SMALL, PpoConfig(), tmp_path, pool, resume=False)
    policy = OnnxPolicy(str(session.run(frames=512, minutes=None)))
    golden = np.array(policy.metadata.golden.outputs)
    assert golden[:, 1] == pytest.approx(np.full(len(golden), VENTED), abs=1e-6)
    action = policy.step(np.full(len(OBSERVATION), 0.3, np.float32), np.array((-0.2, 0.6), np.float32))
    assert action[1] == pytest.approx(0.0, abs=1e-4)
