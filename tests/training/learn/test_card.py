"""A graphics card's way through the learner, checked without one: nothing is left with the CPU."""

import numpy as np
import pytest
import torch
from torch._subclasses.fake_tensor import FakeTensor, FakeTensorDeviceMismatchError, FakeTensorMode

from softarm.training.learn.inference import device_named
from softarm.training.learn.network import NetworkShape, PolicyNetwork
from softarm.training.learn.ppo import Ppo, PpoConfig
from softarm.training.learn.validation import fly, validation_scenarios
from softarm.training.run.recipe import RECIPES, begin
from softarm.training.task.environment import ACTIONS, INPUTS, Environment
from softarm.training.task.reach import TASKS

pytestmark = pytest.mark.slow


@pytest.fixture
def elsewhere(monkeypatch):
    """Torch without numbers, but with devices: what meets a tensor of another one is an error.

    The 'meta' device stands for the card; what is read back from it is zeros.
    """
    monkeypatch.setattr(torch.Tensor, "numpy", lambda tensor: np.zeros(tensor.shape, dtype=np.float32))
    monkeypatch.setattr(FakeTensor, "tolist", lambda tensor: np.zeros(tensor.shape).tolist())
    monkeypatch.setattr(torch.Tensor, "__float__", lambda _: 0.0)
    monkeypatch.setattr(torch.Tensor, "__bool__", lambda _: True)  # the normaliser was never shown anything
    with FakeTensorMode(allow_non_fake_inputs=True):
        yield torch.device("meta")


class HereAndNow:
    """Does a pool's work in this thread, where torch has no numbers."""

    def map(self, function, work):
        return [function(each) for each in work]


@pytest.mark.parametrize(
    "order", ["mlp-lstm", *(pytest.param(order, marks=pytest.mark.prove) for order in ("lstm-mlp", "mlp"))]
)
def test_an_iteration_and_a_flight_leave_no_memory_on_the_card(elsewhere, order):
    with elsewhere:
        network = PolicyNetwork(NetworkShape(INPUTS, ACTIONS, order=order))
    environment = Environment(TASKS["reach"], 8, 0)
    made = Ppo(network, environment, PpoConfig(horizon=4, observation_noise=0.01), HereAndNow(), 0)
    environment._elapsed[:] = 98  # so that some run out of time
    made.iterate()
    fly(network, environment.task, validation_scenarios(environment.task, environment.simulator.links, 6), HereAndNow())
    state = made._observation, made._keep, *made._state, *network.state_dict().values()
    assert {each.device for each in state} == {elsewhere}
    with pytest.raises(FakeTensorDeviceMismatchError):  # or the above would show nothing
        network(torch.ones(1, 8, INPUTS, device="cpu"), made._keep[None], network.initial_state(8))


@pytest.mark.parametrize(("name", "sentence"), [("tpu", "give one of cpu, cuda"), ("cuda", "sees no such card here")])
def test_a_missing_device_is_refused(monkeypatch, tmp_path, name, sentence, pool):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    recipe = RECIPES["reach"].model_copy(update={"settings": {"run.device": name}})
    with pytest.raises(ValueError, match=rf"run\.device is '{name}'.*{sentence}"):
        begin(recipe, 1, tmp_path, pool, resume=False)
    assert not (tmp_path / "latest.pt").exists()
    assert device_named("cpu") == torch.device("cpu")
