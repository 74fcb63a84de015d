"""Proximal policy optimisation for a recurrent policy (Schulman et al. 2017), with the seed's settings.

In an iteration every robot takes `horizon` steps. Advantages come from GAE. The batch is split by robots into
mini-batches of whole sequences, with one gradient step each. The learning rate follows the KL divergence.

Threads compute a mini-batch in micro-batches of fixed size, and the gradients are summed in a fixed order: any number
of threads gives the same result, bit for bit. A graphics card computes a whole mini-batch at once; the robots and all
random numbers stay on the CPU.
"""

import math
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import torch
from torch import Tensor

from softarm.training.learn.inference import infer, share_of
from softarm.training.learn.network import PolicyNetwork, RecurrentState
from softarm.training.task.environment import Environment

MICRO_SEQUENCES = 128


@dataclass(frozen=True)
class PpoConfig:
    """Settings of the learner.

    Defaults are those of the seed ([P] SM-E), except for speed on a CPU (docs/training/training.md).
    """

    horizon: int = 16
    minibatches: int = 4
    mini_epochs: int = 1
    gamma: float = 0.99
    gae_lambda: float = 0.95
    clip: float = 0.2
    value_coefficient: float = 2.0
    bounds_coefficient: float = 1e-4
    bounds_limit: float = 1.1  # means beyond +- this are penalised
    gradient_norm: float = 1.0
    learning_rate: float = 3e-4
    learning_rate_min: float = 1e-5
    learning_rate_max: float = 3e-3
    kl_target: float = 0.008
    observation_noise: float = 0.0  # standard deviation on the normalised observation ([P] SM-F: 0.01)


class Rollout(NamedTuple):
    """Experience of T steps of R robots, [T, R, ...]; values in the reward's unit."""

    observation: Tensor
    keep: Tensor  # 0 where an episode begins
    state: RecurrentState  # before the first step, [R, size] each
    action: Tensor  # as sampled, before any clamp
    mean: Tensor
    value: Tensor
    reward: Tensor
    following: Tensor  # value of the state after each step; 0 after a termination
    done: Tensor  # 1 where an episode ended, by termination or time-out

    def of(self, robots: Tensor) -> "Rollout":
        """Return the experience of some robots, given by their indices."""
        hidden, cell = self.state
        steps = {name: part[:, robots] for name, part in self._asdict().items() if name != "state"}
        return Rollout(**steps | {"state": (hidden[robots], cell[robots])})


class Batch(NamedTuple):
    """Training data of B robots over T steps, [T, B]; values are normalised."""

    flown: Rollout
    old_log_std: Tensor  # [A], the same for all robots
    old_log_probability: Tensor
    advantage: Tensor  # normalised over the whole roll-out
    old_value: Tensor
    target: Tensor  # of the value

    def of(self, robots: Tensor) -> "Batch":
        """Return the data of some robots, given by their indices."""
        steps = (part[:, robots] for part in self[2:])
        return Batch(self.flown.of(robots), self.old_log_std, *steps)


class Statistics(NamedTuple):
    """Figures of one iteration."""

    reward: float  # mean per step, scaled
    success: float  # share of the episodes that ended; NaN when none did
    kl: float
    learning_rate: float
    std: float
    value_loss: float


def generalised_advantage(
    reward: Tensor, value: Tensor, following: Tensor, done: Tensor, gamma: float, gae_lambda: float
) -> Tensor:
    """Return GAE(gamma, lambda) over [T, R] (Schulman et al. 2015, eq. 16).

    `following` is the value of the state after each step: 0 after a termination, the value of the episode's last
    observation after a time-out. `done` ends the sum in both cases.
    """
    error = reward + gamma * following - value
    advantage = torch.empty_like(error)
    later = torch.zeros_like(error[0])
    for t in reversed(range(error.shape[0])):
        later = error[t] + gamma * gae_lambda * (1.0 - done[t]) * later
        advantage[t] = later
    return advantage


def adapted_rate(rate: float, kl: float, config: PpoConfig) -> float:
    """Return the next learning rate: lower above twice the KL target, higher below half of it."""
    if kl > 2.0 * config.kl_target:
        return max(rate / 1.5, config.learning_rate_min)
    if kl < 0.5 * config.kl_target:
        return min(rate * 1.5, config.learning_rate_max)
    return rate


def log_probability(action: Tensor, mean: Tensor, log_std: Tensor) -> Tensor:
    """Return the log-probability of actions [..., A] under independent normal distributions, summed over A."""
    return (-0.5 * ((action - mean) / log_std.exp()) ** 2 - log_std - 0.5 * math.log(2.0 * math.pi)).sum(-1)


def kl_divergence(old_mean: Tensor, old_log_std: Tensor, mean: Tensor, log_std: Tensor) -> Tensor:
    """Return KL(old, new) of independent normal distributions, summed over the last axis and averaged over others."""
    squares = (2 * old_log_std).exp() + (mean - old_mean) ** 2
    return (log_std - old_log_std + 0.5 * squares / (2 * log_std).exp() - 0.5).sum(-1).mean()


def surrogate(
    network: PolicyNetwork, batch: Batch, config: PpoConfig, dtype: torch.dtype = torch.float32
) -> tuple[Tensor, Tensor, Tensor]:
    """Return the clipped surrogate loss (Schulman et al. 2017, eq. 9), the KL divergence and the value loss.

    `dtype` is the type of the matrix products.
    """
    flown = batch.flown
    mean, value, _ = network(flown.observation, flown.keep, flown.state, dtype)
    ratio = torch.exp(log_probability(flown.action, mean, network.log_std) - batch.old_log_probability)
    clipped_ratio = ratio.clamp(1 - config.clip, 1 + config.clip)
    gain = torch.minimum(ratio * batch.advantage, clipped_ratio * batch.advantage)
    clipped_value = batch.old_value + (value - batch.old_value).clamp(-config.clip, config.clip)
    value_loss = torch.maximum((value - batch.target) ** 2, (clipped_value - batch.target) ** 2).mean()
    beyond = torch.relu(mean.abs() - config.bounds_limit).square().sum(-1).mean()
    loss = -gain.mean() + 0.5 * config.value_coefficient * value_loss + config.bounds_coefficient * beyond
    kl = kl_divergence(flown.mean, batch.old_log_std, mean, network.log_std)
    return loss, kl, value_loss


class Ppo:
    """Learner with its optimiser, random numbers and the state of the robots."""

    def __init__(
        self,
        network: PolicyNetwork,
        environment: Environment,
        config: PpoConfig,
        pool: Executor,
        seed: int,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        """Prepare the learner. Raises ValueError if the robots do not split into the mini-batches."""
        if environment.robots % config.minibatches:
            raise ValueError(
                f"{environment.robots} robots do not split into {config.minibatches} mini-batches; "
                f"give a multiple of {config.minibatches}"
            )
        self.network, self.environment, self.config = network, environment, config
        self.optimiser = torch.optim.Adam(network.parameters(), lr=config.learning_rate)
        self.learning_rate = config.learning_rate
        self._pool, self._dtype = pool, dtype
        self._generator = torch.Generator().manual_seed(seed)
        self._parameters = list(network.parameters())
        self._device = network.device
        self._observation = self._there(environment.reset())
        environment.stagger()
        self._keep = torch.zeros(environment.robots, device=self._device)
        self._state = network.initial_state(environment.robots)

    def iterate(self, critic_only: bool = False) -> Statistics:
        """Collect one roll-out and learn from it; with `critic_only` only the value head learns."""
        if self.network.observation_normaliser.count == 0:
            self.network.observation_normaliser.update(self._collect()[0].observation)
        rollout, success = self._collect()
        statistics = self._learn(rollout, critic_only)
        # After learning, so that learning uses the same normalisation as acting.
        self.network.observation_normaliser.update(rollout.observation)
        return statistics._replace(success=success)

    def _collect(self) -> tuple[Rollout, float]:
        network, first_state = self.network, self._state
        std = network.log_std.detach().exp()
        rows: list[tuple[Tensor, ...]] = []
        cut: list[tuple[Tensor, Tensor]] = []  # robots with a time-out, and the value of their last state
        ended = reached = 0
        for _ in range(self.config.horizon):
            mean, value, state = self._infer(self._observation, self._keep, self._state)
            action = mean + std * self._normal(mean.shape)
            step = self.environment.step(action.cpu().numpy())
            over = step.terminated | step.truncated
            done = self._there(over)
            cut.append(self._values_of(step.truncated, step.final_observation, state))
            reward, terminated = self._there(step.reward), self._there(step.terminated)
            rows.append((self._observation, self._keep, action, mean, value, reward, terminated, done.float()))
            seen = self._noisy(self._there(step.observation))
            self._observation, self._keep, self._state = seen, 1.0 - done.float(), state
            ended, reached = ended + int(over.sum()), reached + int(step.success.sum())
        observation, keep, action, mean, value, reward, terminated, done = map(torch.stack, zip(*rows, strict=True))
        _, last_value, _ = self._infer(self._observation, self._keep, self._state)
        following = torch.cat((value[1:], last_value[None]))
        for t, (robots, values) in enumerate(cut):
            following[t, robots] = values
        following[terminated] = 0.0
        rollout = Rollout(observation, keep, first_state, action, mean, value, reward, following, done)
        return rollout, reached / ended if ended else math.nan

    def _noisy(self, observation: Tensor) -> Tensor:
        """Add the observation noise of a policy that must tolerate noise."""
        if not self.config.observation_noise:
            return observation
        noise = self._normal(observation.shape)
        return observation + self.config.observation_noise * self.network.observation_normaliser.scale() * noise

    def _infer(self, observation: Tensor, keep: Tensor, state: RecurrentState) -> tuple[Tensor, Tensor, RecurrentState]:
        return infer(self.network, observation, keep, state, self._pool, self._dtype)

    def _values_of(self, which: Any, observation: Any, state: RecurrentState) -> tuple[Tensor, Tensor]:
        indices = which.nonzero()[0]
        robots = self._there(indices)
        if len(robots) == 0:
            return robots, torch.empty(0, device=self._device)
        seen, kept = self._there(observation[indices]), torch.ones(len(robots), device=self._device)
        _, value, _ = self._infer(seen, kept, (state[0][robots], state[1][robots]))
        return robots, value

    def _there(self, array: Any) -> Tensor:
        """Copy an array of the environment to the network's device."""
        return torch.from_numpy(array).to(self._device)

    def _normal(self, shape: torch.Size) -> Tensor:
        """Draw normally distributed numbers, the same on every device."""
        return torch.randn(shape, generator=self._generator).to(self._device)

    def _learn(self, rollout: Rollout, critic_only: bool = False) -> Statistics:
        config, network = self.config, self.network
        parameters = list(network.value_head.parameters()) if critic_only else self._parameters
        advantage = generalised_advantage(
            rollout.reward, rollout.value, rollout.following, rollout.done, config.gamma, config.gae_lambda
        )
        returns = rollout.value + advantage
        network.value_normaliser.update(returns.unsqueeze(-1))
        old_value, target = (
            network.value_normaliser(each.unsqueeze(-1)).squeeze(-1) for each in (rollout.value, returns)
        )
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        old_log_std = network.log_std.detach().clone()
        old_log_probability = log_probability(rollout.action, rollout.mean, old_log_std)
        for group in self.optimiser.param_groups:
            group["lr"] = self.learning_rate

        whole = Batch(rollout, old_log_std, old_log_probability, advantage, old_value, target)
        robots = rollout.reward.shape[1]
        figures = []
        for _ in range(config.mini_epochs):
            order = torch.randperm(robots, generator=self._generator).to(self._device)
            for chosen in order.chunk(config.minibatches):
                micro = chosen.split(share_of(len(chosen), MICRO_SEQUENCES, self._device))
                gradient = partial(self._gradient, batch=whole, parameters=parameters, size=len(chosen))
                results = list(self._pool.map(gradient, micro))
                for k, parameter in enumerate(parameters):
                    parameter.grad = torch.stack([gradients[k] for gradients, _ in results]).sum(0)
                torch.nn.utils.clip_grad_norm_(parameters, config.gradient_norm)
                self.optimiser.step()
                figures.append(torch.stack([figure for _, figure in results]).sum(0))
        kl, value_loss = torch.stack(figures).mean(0).tolist()
        used = self.learning_rate
        if not critic_only:
            self.learning_rate = adapted_rate(used, kl, config)
        std = float(network.log_std.detach().exp().mean())
        return Statistics(float(rollout.reward.mean()), math.nan, kl, used, std, value_loss)

    def _gradient(
        self, robots: Tensor, batch: Batch, parameters: list[Tensor], size: int
    ) -> tuple[tuple[Tensor, ...], Tensor]:
        """Return the gradients of some robots, weighted by their share of a mini-batch, with KL and value loss."""
        loss, kl, value_loss = surrogate(self.network, batch.of(robots), self.config, self._dtype)
        share = len(robots) / size
        return torch.autograd.grad(loss * share, parameters), share * torch.stack((kl, value_loss)).detach()

    def snapshot(self) -> dict[str, Any]:
        """Return the state for `restore`, exact to the bit; tensors and plain values only."""
        return {
            "network": self.network.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "learning_rate": self.learning_rate,
            "generator": self._generator.get_state(),
            "environment": self.environment.snapshot(),
            "observation": self._observation,
            "keep": self._keep,
            "state": list(self._state),
        }

    def restore(self, content: dict[str, Any]) -> None:
        """Restore a snapshot of a learner with the same arguments."""
        self.network.load_state_dict(content["network"])
        self.optimiser.load_state_dict(content["optimiser"])
        self.learning_rate = content["learning_rate"]
        self._generator.set_state(content["generator"])
        self.environment.restore(content["environment"])
        self._observation, self._keep = content["observation"].to(self._device), content["keep"].to(self._device)
        self._state = (content["state"][0].to(self._device), content["state"][1].to(self._device))
