"""Behaviour cloning: padding, episodes' states, held-out episodes and the learned actions."""

import numpy as np
import torch

from softarm.policies.base import HIGH, LOW
from softarm.training.learn.inference import workers
from softarm.training.learn.network import NetworkShape, PolicyNetwork
from softarm.training.run.clone import Cloner, CloningConfig, Demonstration, padded, squared_errors

SMALL = NetworkShape(mlp=(16,), state=8)


def demonstrations(count: int = 20) -> list[Demonstration]:
    """Return episodes whose action depends on the present and the first observation."""
    rng, made = np.random.default_rng(0), []
    for length in rng.integers(3, 12, count):
        seen = rng.normal(size=(length, 10)).astype(np.float32)
        share = 0.5 + 0.4 * np.tanh(np.stack((seen[:, 0], np.full(length, seen[0, 1])), axis=1))
        made.append(Demonstration(seen, (LOW + share * (HIGH - LOW)).astype(np.float32)))
    return made


def network(seed: int = 0) -> PolicyNetwork:
    torch.manual_seed(seed)
    return PolicyNetwork(SMALL)


def test_padding_does_not_count_and_an_episode_begins_with_an_empty_state():
    episodes, made = demonstrations(3), network()
    alone = [squared_errors(made, padded([each]), torch.float32)[:, 0] for each in episodes]
    together = squared_errors(made, padded(episodes), torch.float32)
    for k, each in enumerate(alone):
        torch.testing.assert_close(together[: len(each), k], each, rtol=1e-5, atol=1e-6)
        assert not together[len(each) :, k].any()


def test_physical_actions_are_scaled_to_the_networks_range():
    ends = Demonstration(np.zeros((3, 10), dtype=np.float32), np.stack((LOW, (LOW + HIGH) / 2, HIGH)))
    action = padded([ends]).action[:, 0]
    torch.testing.assert_close(action, torch.tensor([[-1.0, -1.0], [0.0, 0.0], [1.0, 1.0]]))


def test_cloning_lowers_the_error_on_episodes_that_are_not_learned(pool):
    episodes, made = demonstrations(60), network()
    cloner = Cloner(made, episodes, CloningConfig(batch=16, learning_rate=1e-2), pool, seed=1)
    assert cloner.frames < sum(len(each.action) for each in episodes)
    before = cloner.held_out_error(made)
    for _ in range(60):
        cloner.iterate()
    assert cloner.held_out_error(made) < 0.5 * before


def test_a_restored_learner_continues_to_the_bit(pool):
    whole, first, rest = (Cloner(network(), demonstrations(), CloningConfig(batch=8), pool, seed=3) for _ in range(3))
    for learner in (whole, whole, first):
        learner.iterate()
    rest.restore(first.snapshot())
    rest.iterate()
    for mine, theirs in zip(rest.network.parameters(), whole.network.parameters(), strict=True):
        assert torch.equal(mine, theirs)


def test_the_number_of_threads_changes_no_bit():
    weights = []
    for count in (1, 2):
        with workers(count) as pool:
            learner = Cloner(network(), demonstrations(90), CloningConfig(batch=80), pool, seed=3)
            learner.iterate()
            weights.append(learner.network.mean_head.weight.detach().clone())
    assert torch.equal(*weights)
