"""The learner's pieces, against numbers worked out by hand."""

import math

import pytest
import torch

from softarm.training.learn.inference import workers
from softarm.training.learn.network import NetworkShape, PolicyNetwork, RunningNormaliser
from softarm.training.learn.ppo import (
    Ppo,
    PpoConfig,
    adapted_rate,
    generalised_advantage,
    kl_divergence,
    log_probability,
)
from softarm.training.task.environment import ACTIONS, INPUTS, Environment
from softarm.training.task.reach import TASKS


def column(*values: float) -> torch.Tensor:
    return torch.tensor(values).unsqueeze(-1)


def test_the_advantage_distinguishes_termination_and_time_out():
    # gamma = 0.5, lambda = 0.5. Step 1 ends an episode, step 3 goes on beyond the roll-out.
    reward, value = column(1.0, 2.0, 3.0, 4.0), column(10.0, 20.0, 30.0, 40.0)
    done = column(0.0, 1.0, 0.0, 0.0)
    terminated = column(20.0, 0.0, 40.0, 50.0)  # nothing follows step 1
    # Errors: 1 + 10 - 10 = 1, 2 + 0 - 20 = -18, 3 + 20 - 30 = -7, 4 + 25 - 40 = -11.
    expected = column(1.0 + 0.25 * -18.0, -18.0, -7.0 + 0.25 * -11.0, -11.0)
    torch.testing.assert_close(generalised_advantage(reward, value, terminated, done, 0.5, 0.5), expected)
    timed_out = column(20.0, 8.0, 40.0, 50.0)  # the last observation was worth 8
    expected[1] = 2.0 + 0.5 * 8.0 - 20.0
    expected[0] = 1.0 + 0.25 * expected[1]
    torch.testing.assert_close(generalised_advantage(reward, value, timed_out, done, 0.5, 0.5), expected)


@pytest.mark.parametrize(
    ("kl", "rate", "expected"),
    [
        (0.017, 3e-4, 2e-4),
        (0.0159, 3e-4, 3e-4),
        (0.0041, 3e-4, 3e-4),
        (0.0039, 2e-4, 3e-4),
        (0.0, 2.9e-3, 3e-3),
        (1.0, 1.2e-5, 1e-5),
    ],
)
def test_the_learning_rate_follows_the_divergence_within_its_bounds(kl, rate, expected):
    assert adapted_rate(rate, kl, PpoConfig(kl_target=0.008)) == pytest.approx(expected)


def test_probability_and_divergence_equal_torch_distributions():
    generator = torch.Generator().manual_seed(0)
    action, old, new = (torch.randn(5, 4, 2, generator=generator) for _ in range(3))
    old_std, new_std = torch.tensor([0.1, -0.5]), torch.tensor([-0.3, 0.2])
    before = torch.distributions.Normal(old, old_std.exp())
    after = torch.distributions.Normal(new, new_std.exp())
    torch.testing.assert_close(log_probability(action, new, new_std), after.log_prob(action).sum(-1))
    expected = torch.distributions.kl_divergence(before, after).sum(-1).mean()
    torch.testing.assert_close(kl_divergence(old, old_std, new, new_std), expected)
    assert float(kl_divergence(old, old_std, old, old_std)) == pytest.approx(0.0, abs=1e-7)


def test_the_normaliser_has_mean_and_variance_of_all_values():
    generator = torch.Generator().manual_seed(0)
    batches = [torch.randn(n, 3, generator=generator) * 5.0 + 100.0 for n in (1, 17, 400)]
    normaliser = RunningNormaliser(3)
    for batch in batches:
        normaliser.update(batch)
    everything = torch.cat(batches).double()
    torch.testing.assert_close(normaliser.mean, everything.mean(0))
    torch.testing.assert_close(normaliser.variance, everything.var(0, correction=0))
    torch.testing.assert_close(normaliser.restore(normaliser(batches[1])), batches[1])


def learner(pool, robots=16, **config) -> Ppo:
    torch.manual_seed(0)
    network = PolicyNetwork(NetworkShape(INPUTS, ACTIONS))
    return Ppo(network, Environment(TASKS["reach"], robots, 0), PpoConfig(**config), pool, 0)


def test_the_following_value_is_zero_after_a_termination_and_not_after_a_time_out(pool):
    ppo = learner(pool, robots=64)
    ppo.environment._elapsed[:] = 95  # everybody runs out of time within the roll-out
    first = ppo._observation.clone()
    rollout, *_ = ppo._collect()
    assert torch.equal(rollout.observation[0], first)
    assert torch.all(rollout.keep[0] == 0.0)  # the first observation begins an episode
    torch.testing.assert_close(rollout.keep[1:], 1.0 - rollout.done[:-1])
    going_on = rollout.done[:-1] == 0.0
    torch.testing.assert_close(rollout.following[:-1][going_on], rollout.value[1:][going_on])
    timed_out = rollout.done[4] == 1.0
    assert timed_out.sum() > 32
    # It is the old episode's value, with its memory: not zero, and not that of the new episode's first step.
    assert torch.all(rollout.following[4][timed_out] != 0.0)
    assert torch.all(rollout.following[4][timed_out] != rollout.value[5][timed_out])


def test_the_number_of_threads_changes_no_bit():
    results = []
    for count in (1, 3):
        with workers(count) as pool:
            ppo = learner(pool, robots=1024, horizon=2, minibatches=2)
            ppo.iterate()
            results.append(ppo.network.state_dict())
    assert all(torch.equal(results[0][key], results[1][key]) for key in results[0])


def test_learning_raises_the_value_of_good_actions(pool):
    """One batch learned again and again: actions that paid become likelier than those that did not."""
    ppo = learner(pool, robots=64, minibatches=1, mini_epochs=5, learning_rate=1e-3)
    rollout, *_ = ppo._collect()
    rollout = rollout._replace(
        reward=rollout.action[..., 0],
        value=torch.zeros_like(rollout.value),
        done=torch.ones_like(rollout.done),
        following=torch.zeros_like(rollout.following),
    )
    before = rollout.mean[..., 0].mean()
    kl, value_loss = ppo._learn(rollout)
    with torch.no_grad():
        mean, _, _ = ppo.network(rollout.observation, rollout.keep, rollout.state)
    assert float(mean[..., 0].mean() - before) > 0.02
    assert kl > 0.0
    assert math.isfinite(value_loss)


def test_a_number_of_robots_that_does_not_split_is_refused(pool):
    with pytest.raises(ValueError, match="multiple of 4"):
        learner(pool, robots=18)
