"""Training in tensors: learner and environment run here on the CPU, and on a graphics card where there is one."""

import copy

import pytest
import torch

from softarm.training.learn.inference import device_named
from softarm.training.learn.network import NetworkShape, PolicyNetwork
from softarm.training.learn.ppo import EAGER_ITERATIONS, Ppo, PpoConfig
from softarm.training.learn.validation import fly, validation_scenarios
from softarm.training.run.recipe import RECIPES, begin
from softarm.training.task.environment import ACTIONS, INPUTS
from softarm.training.task.reach import TASKS
from softarm.training.task.tensor_environment import TensorEnvironment

card = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a graphics card")
DEVICES = ["cpu", pytest.param("cuda", marks=card)]


def _learner(device, pool) -> Ppo:
    torch.manual_seed(0)
    network = PolicyNetwork(NetworkShape(INPUTS, ACTIONS, (16,), 16)).to(device)
    environment = TensorEnvironment(TASKS["reach"], 32, 0, device=device)
    return Ppo(network, environment, PpoConfig(horizon=4, observation_noise=0.01), pool, 0)


@pytest.mark.slow
@pytest.mark.parametrize("device", DEVICES)
def test_a_restored_learner_goes_on_with_the_same_bits(device, pool):
    """Iterations that are restored come before and after the capture of a graph."""
    one, other = _learner(device, pool), _learner(device, pool)
    one.iterate()
    other.restore(copy.deepcopy(one.snapshot()))
    for learner in (one, other):
        for _ in range(EAGER_ITERATIONS + 1):
            learner.iterate()
    weights = [each.network.state_dict() for each in (one, other)]
    for name, value in weights[0].items():
        torch.testing.assert_close(weights[1][name], value, atol=1e-5 if device == "cuda" else 0.0, rtol=0.0)
    assert one.network.device.type == device


@card
@pytest.mark.slow
def test_a_flight_on_a_card_equals_that_of_the_cpu(pool):
    torch.manual_seed(0)
    network = PolicyNetwork(NetworkShape(INPUTS, ACTIONS))
    scenarios = validation_scenarios(TASKS["reach"], 5, 96)
    flown = [fly(network.to(device), TASKS["reach"], scenarios, pool) for device in ("cpu", "cuda")]
    torch.testing.assert_close(*(torch.from_numpy(each.closest_m) for each in flown), atol=2e-3, rtol=0.0)


@pytest.mark.parametrize(("name", "sentence"), [("tpu", "allowed: 'cpu'"), ("cuda", "sees no such card here")])
def test_a_missing_device_is_refused(monkeypatch, tmp_path, name, sentence, pool):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    recipe = RECIPES["reach"].model_copy(update={"settings": {"run.device": name}})
    with pytest.raises(ValueError, match=rf"run\.device is '{name}'.*{sentence}"):
        begin(recipe, 1, tmp_path, pool, resume=False)
    assert not (tmp_path / "latest.pt").exists()
    assert device_named("cpu") == torch.device("cpu")
