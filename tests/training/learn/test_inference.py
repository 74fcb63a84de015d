"""Inference for many robots."""

import numpy as np
import pytest
import torch

from softarm.training.learn.inference import actor
from softarm.training.learn.network import NetworkShape, PolicyNetwork


def test_only_robots_that_still_fly_are_computed_and_their_memory_goes_on(pool):
    torch.manual_seed(3)
    network = PolicyNetwork(NetworkShape(mlp=(16,), state=8))
    every, some = actor(network, 5, pool), actor(network, 5, pool)
    computed = []
    network.register_forward_pre_hook(lambda _, given: computed.append(given[0].shape[1]))
    flying = np.array([True, False, True, False, True])
    for k, observation in enumerate(np.random.default_rng(4).normal(size=(3, 5, 10)).astype(np.float32)):
        whole = every(observation, np.ones(5, np.bool_))
        part = some(observation, flying if k else np.ones(5, np.bool_))
        assert part[flying] == pytest.approx(whole[flying], abs=1e-6)
    assert computed == [5, 5, 5, 3, 5, 3]
