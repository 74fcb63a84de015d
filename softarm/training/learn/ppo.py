"""Proximal policy optimisation for a recurrent policy (Schulman et al. 2017), with the seed's settings.

In an iteration every robot takes `horizon` steps. Advantages come from GAE. The batch is split by robots into
mini-batches of whole sequences, with one gradient step each. The learning rate follows the KL divergence.

Threads compute a mini-batch in micro-batches of fixed size, and the gradients are summed in a fixed order: any number
of threads gives the same result, bit for bit. A graphics card also has the robots and the random numbers, computes a
whole mini-batch at once, and replays an iteration as a CUDA graph.
"""

import math
from collections.abc import Iterable
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, NamedTuple

import torch
from pydantic import Field
from torch import Tensor

from softarm.schemas.base import Strict
from softarm.training.learn.inference import infer
from softarm.training.learn.network import PolicyNetwork, RecurrentState
from softarm.training.task.environment import Environment
from softarm.training.task.tensor_environment import TensorEnvironment

MICRO_SEQUENCES = 128
# Iterations before a graph is captured: they allocate what a capture must find.
EAGER_ITERATIONS = 3


@dataclass(frozen=True)
class PpoConfig:
    """Settings of the learner.

    Defaults are those of the seed ([P] SM-E), except for speed on a CPU (docs/training/training.md).
    """

    __pydantic_config__ = Strict.model_config

    horizon: Annotated[int, Field(ge=1)] = 16
    minibatches: Annotated[int, Field(ge=1)] = 4
    mini_epochs: Annotated[int, Field(ge=1)] = 1
    gamma: Annotated[float, Field(ge=0, le=1)] = 0.99
    gae_lambda: Annotated[float, Field(ge=0, le=1)] = 0.95
    clip: Annotated[float, Field(gt=0)] = 0.2
    value_coefficient: Annotated[float, Field(ge=0)] = 2.0
    bounds_coefficient: Annotated[float, Field(ge=0)] = 1e-4
    bounds_limit: Annotated[float, Field(ge=0)] = 1.1  # means beyond +- this are penalised
    gradient_norm: Annotated[float, Field(gt=0)] = 1.0
    learning_rate: Annotated[float, Field(gt=0, le=1)] = 3e-4
    learning_rate_min: Annotated[float, Field(gt=0, le=1)] = 1e-5
    learning_rate_max: Annotated[float, Field(gt=0, le=1)] = 3e-3
    kl_target: Annotated[float, Field(gt=0)] = 0.008
    # Standard deviation on the normalised observation ([P] SM-F: 0.01).
    observation_noise: Annotated[float, Field(ge=0)] = 0.0


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


def descend(
    optimiser: torch.optim.Optimizer,
    parameters: list[Tensor],
    parts: Iterable[tuple[tuple[Tensor, ...], Tensor]],
    gradient_norm: float,
) -> Tensor:
    """Take a step along the sum of the gradients of a batch's parts, and return the sum of their figures.

    The order of the parts, not that of their computation, determines the result to the bit.
    """
    results = list(parts)
    for parameter, *gradients in zip(parameters, *(each for each, _ in results), strict=True):
        parameter.grad = torch.stack(gradients).sum(0) if len(gradients) > 1 else gradients[0]
    torch.nn.utils.clip_grad_norm_(parameters, gradient_norm)
    optimiser.step()
    return torch.stack([figure for _, figure in results]).sum(0)


class Ppo:
    """Learner with its optimiser, random numbers and the state of the robots."""

    def __init__(
        self,
        network: PolicyNetwork,
        environment: Environment | TensorEnvironment,
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
        self._device = network.device
        self._on_card = self._device.type == "cuda"
        rate = self._rate(config.learning_rate)
        self.optimiser = torch.optim.Adam(network.parameters(), lr=rate, capturable=self._on_card)
        self.learning_rate = config.learning_rate
        self._pool, self._dtype = pool, dtype
        self._generator = torch.Generator(self._device).manual_seed(seed)
        self._parameters = list(network.parameters())
        self._observation = torch.as_tensor(environment.reset())
        environment.stagger()
        self._keep = torch.zeros(environment.robots, device=self._device)
        self._state = network.initial_state(environment.robots)
        self._iterations = 0
        self._graph: torch.cuda.CUDAGraph | None = None
        self._figures: Tensor | None = None

    @property
    def frames(self) -> int:
        """Return the control steps of an iteration, summed over the robots."""
        return self.environment.robots * self.config.horizon

    def iterate(self, critic_only: bool = False) -> Statistics:
        """Collect one roll-out and learn from it; with `critic_only` only the value head learns."""
        if self.network.observation_normaliser.count == 0:
            rollout, carried, _ = self._collect()
            self._carry(*carried)
            self.network.observation_normaliser.update(rollout.observation)
        self._set_rate()
        figures = self._replay() if self._on_card and not critic_only else self._iteration(critic_only)
        reward, ended, reached, kl, value_loss, std = figures.tolist()
        used = self.learning_rate
        if not critic_only:
            self.learning_rate = adapted_rate(used, kl, self.config)
        return Statistics(reward, reached / ended if ended else math.nan, kl, used, std, value_loss)

    def _iteration(self, critic_only: bool = False) -> Tensor:
        """Run an iteration without waiting for the device; return its figures."""
        rollout, carried, counts = self._collect()
        kl, value_loss = self._learn(rollout, critic_only)
        # After learning, so that learning uses the same normalisation as acting.
        self.network.observation_normaliser.update(rollout.observation)
        self._carry(*carried)
        std = self.network.log_std.detach().exp().mean()
        return torch.stack((rollout.reward.mean(), *counts, kl, value_loss, std)).double()

    def _replay(self) -> Tensor:
        """Run an iteration on a graphics card; after the first ones as a graph."""
        self._iterations += 1
        if self._iterations <= EAGER_ITERATIONS:
            # Captures demand a stream of their own, and gradients the stream of their first use.
            stream = torch.cuda.Stream()
            stream.wait_stream(torch.cuda.current_stream())
            with torch.cuda.stream(stream):
                figures = self._iteration()
            torch.cuda.current_stream().wait_stream(stream)
            return figures
        if self._graph is None:
            self._graph = torch.cuda.CUDAGraph()
            for generator in (self._generator, self.environment.generator):  # type: ignore[union-attr]
                self._graph.register_generator_state(generator)
            with torch.cuda.graph(self._graph):
                self._figures = self._iteration()
        self._graph.replay()
        assert self._figures is not None, "the capture sets the figures"
        return self._figures

    def _collect(self) -> tuple[Rollout, tuple[Tensor, Tensor, RecurrentState], tuple[Tensor, Tensor]]:
        """Return a roll-out, the observation, `keep` and state after it, and the numbers of ended and reached goals."""
        network, environment = self.network, self.environment
        observation, keep, state = self._observation, self._keep, self._state
        std = network.log_std.detach().exp()
        rows: list[tuple[Tensor, ...]] = []
        ends: list[tuple[Tensor, ...]] = []  # last observations and states of truncated episodes; on a card all
        ended = reached = torch.zeros((), device=self._device)
        for _ in range(self.config.horizon):
            mean, value, after = self._infer(observation, keep, state)
            action = mean + std * self._normal(mean.shape)
            step = environment.step(action if isinstance(environment, TensorEnvironment) else action.numpy())
            seen, reward, terminated, truncated, success, final, _ = map(torch.as_tensor, step)
            done = (terminated | truncated).float()
            rows.append((observation, keep, action, mean, value, reward, terminated, done, truncated))
            # Choosing robots would wait for the card.
            ends.append((final, *after) if self._on_card else tuple(each[truncated] for each in (final, *after)))
            observation, keep, state = self._noisy(seen), 1.0 - done, after
            ended, reached = ended + done.sum(), reached + success.sum()
        seen, kept, action, mean, value, reward, terminated, done, truncated = map(torch.stack, zip(*rows, strict=True))
        final, *memory = map(torch.cat, zip(*ends, strict=True))
        _, cut, _ = self._infer(final, torch.ones_like(final[:, 0]), (memory[0], memory[1]))
        cut = cut.view_as(value) if self._on_card else torch.zeros_like(value).masked_scatter(truncated, cut)
        _, last_value, _ = self._infer(observation, keep, state)
        following = torch.where(truncated, cut, torch.cat((value[1:], last_value[None])))
        following = following.masked_fill(terminated, 0.0)
        rollout = Rollout(seen, kept, self._state, action, mean, value, reward, following, done)
        return rollout, (observation, keep, state), (ended, reached)

    def _carry(self, observation: Tensor, keep: Tensor, state: RecurrentState) -> None:
        """Begin the next roll-out where one ended, in the same memory, which a graph needs."""
        mine = (self._observation, self._keep, *self._state)
        for old, new in zip(mine, (observation, keep, *state), strict=True):
            old.copy_(new)

    def _noisy(self, observation: Tensor) -> Tensor:
        """Add the observation noise of a policy that must tolerate noise."""
        if not self.config.observation_noise:
            return observation
        noise = self._normal(observation.shape)
        return observation + self.config.observation_noise * self.network.observation_normaliser.scale() * noise

    def _infer(self, observation: Tensor, keep: Tensor, state: RecurrentState) -> tuple[Tensor, Tensor, RecurrentState]:
        return infer(self.network, observation, keep, state, self._pool, self._dtype)

    def _normal(self, shape: torch.Size) -> Tensor:
        """Draw normally distributed numbers."""
        return torch.randn(shape, generator=self._generator, device=self._device)

    def _rate(self, rate: float) -> Any:
        """Return a learning rate for the optimiser; a graph reads it from the card."""
        return torch.tensor(rate, device=self._device) if self._on_card else rate

    def _set_rate(self) -> None:
        for group in self.optimiser.param_groups:
            if self._on_card:
                group["lr"].fill_(self.learning_rate)
            else:
                group["lr"] = self.learning_rate

    def _learn(self, rollout: Rollout, critic_only: bool = False) -> tuple[Tensor, Tensor]:
        """Learn from a roll-out; return the mean KL divergence and value loss."""
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

        whole = Batch(rollout, old_log_std, old_log_probability, advantage, old_value, target)
        robots = rollout.reward.shape[1]
        figures = []
        for _ in range(config.mini_epochs):
            # Robots on a card are alike, and their order is part of the graph.
            order = (
                torch.arange(robots, device=self._device)
                if self._on_card
                else torch.randperm(robots, generator=self._generator)
            )
            for chosen in order.chunk(config.minibatches):
                micro = chosen.split(MICRO_SEQUENCES)
                gradient = partial(self._gradient, batch=whole, parameters=parameters, size=len(chosen))
                parts = [gradient(chosen)] if self._on_card else self._pool.map(gradient, micro)
                figures.append(descend(self.optimiser, parameters, parts, config.gradient_norm))
        kl, value_loss = torch.stack(figures).mean(0)
        return kl, value_loss

    def _gradient(
        self, robots: Tensor, batch: Batch, parameters: list[Tensor], size: int
    ) -> tuple[tuple[Tensor, ...], Tensor]:
        """Return the gradients of some robots, weighted by their share of a mini-batch, with KL and value loss."""
        loss, kl, value_loss = surrogate(self.network, batch.of(robots), self.config, self._dtype)
        share = len(robots) / size
        return torch.autograd.grad(loss * share, parameters), share * torch.stack((kl, value_loss)).detach()

    def held_out_error(self, network: PolicyNetwork) -> None:
        """Return None: no actions are given."""

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
        for group in self.optimiser.param_groups:
            group["lr"] = self._rate(content["learning_rate"])
        self.learning_rate = content["learning_rate"]
        self._generator.set_state(content["generator"])
        self.environment.restore(content["environment"])
        self._carry(content["observation"], content["keep"], content["state"])
