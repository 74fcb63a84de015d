"""Behaviour cloning: a learner of the actions in recorded episodes, and its training run.

The run has the files, the validation and the report of any other run.
"""

# mypy: allow-untyped-decorators

import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from softarm.policies.base import HIGH, LOW
from softarm.schemas.policy import REACH_GOAL, Observation
from softarm.simulator import model_file
from softarm.training.learn.network import PolicyNetwork
from softarm.training.learn.ppo import Statistics, descend
from softarm.training.record.checkpoint import flat
from softarm.training.run.recipe import Recipe, prepare
from softarm.training.run.session import Session
from softarm.training.task.environment import Environment
from softarm.training.task.reach import Range, ReachTask
from softarm.training.task.tensor_environment import TensorEnvironment

Array = NDArray[np.float32]
MICRO = 64  # episodes a thread takes at once
UNUSED = ("value_head", "log_std")  # parameters without influence on the actions


@dataclass(frozen=True)
class CloningConfig:
    """Settings of the learner."""

    held_out: float = 0.1  # share of the episodes that are not learned
    batch: int = 128  # episodes of a step
    learning_rate: float = 1e-3
    gradient_norm: float = 1.0


class Demonstration(NamedTuple):
    """Episode from its start: observations [T, inputs] with the goal, actions [T, 2] in m/s and kPa."""

    observation: Array
    action: Array


class Sequences(NamedTuple):
    """Episodes of different lengths, padded at their ends: [T, E, ...]."""

    observation: Tensor
    action: Tensor  # in -1..1
    mask: Tensor  # 1 within an episode, 0 in its padding

    def of(self, episodes: Tensor) -> "Sequences":
        """Return some episodes, given by their indices, padded to the longest of them."""
        longest = int(self.mask[:, episodes].sum(0).max())
        return Sequences(*(part[:longest, episodes] for part in self))


def padded(episodes: Sequence[Demonstration]) -> Sequences:
    """Return episodes as one batch."""
    scaled = [2.0 * (episode.action - LOW) / (HIGH - LOW) - 1.0 for episode in episodes]
    pad = torch.nn.utils.rnn.pad_sequence
    return Sequences(
        pad([torch.from_numpy(episode.observation) for episode in episodes]),
        pad([torch.from_numpy(action.astype(np.float32)) for action in scaled]),
        pad([torch.ones(len(action)) for action in scaled]),
    )


def squared_errors(network: PolicyNetwork, episodes: Sequences, dtype: torch.dtype) -> Tensor:
    """Return the squared action error of every step [T, E], averaged over the actions; 0 in the padding."""
    keep = torch.ones_like(episodes.mask)
    mean, _, _ = network(episodes.observation, keep, network.initial_state(keep.shape[1]), dtype)
    return (mean - episodes.action).square().mean(-1) * episodes.mask


class Cloner:
    """Learner with its optimiser and random numbers; each episode starts with an empty recurrent state."""

    def __init__(
        self,
        network: PolicyNetwork,
        episodes: Sequence[Demonstration],
        config: CloningConfig,
        pool: Executor,
        seed: int,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        """Split two or more episodes by the seed."""
        held_out = max(1, round(config.held_out * len(episodes)))
        self.network, self.config = network, config
        self._pool, self._dtype = pool, dtype
        self._generator = torch.Generator().manual_seed(seed)
        order = torch.randperm(len(episodes), generator=self._generator)
        whole = padded(episodes)
        self._held_out, self._learned = whole.of(order[:held_out]), whole.of(order[held_out:])
        self._optimiser = torch.optim.Adam(network.parameters(), lr=config.learning_rate)
        network.observation_normaliser.update(self._learned.observation[self._learned.mask > 0])

    @property
    def frames(self) -> int:
        """Return the control steps of a pass."""
        return int(self._learned.mask.sum())

    def iterate(self) -> Statistics:
        """Learn from every episode once, in a new order."""
        parameters = [each for name, each in self.network.named_parameters() if not name.startswith(UNUSED)]
        lengths = self._learned.mask.sum(0)
        # Episodes of similar lengths share a batch, which spares padding.
        order = (lengths * (1.0 + torch.rand(len(lengths), generator=self._generator))).argsort()
        batches = order.split(self.config.batch)
        for k in torch.randperm(len(batches), generator=self._generator).tolist():
            batch = self._learned.of(batches[k])
            gradient = partial(self._gradient, batch=batch, parameters=parameters, steps=float(batch.mask.sum()))
            micro = torch.arange(batch.mask.shape[1]).split(MICRO)
            descend(self._optimiser, parameters, self._pool.map(gradient, micro), self.config.gradient_norm)
        nothing = math.nan
        return Statistics(nothing, nothing, nothing, self.config.learning_rate, nothing, nothing)

    @torch.no_grad()
    def held_out_error(self, network: PolicyNetwork) -> float:
        """Return the root mean square of the action error on the held-out episodes; actions span -1 to 1."""
        errors = squared_errors(network, self._held_out, self._dtype)
        return float((errors.sum() / self._held_out.mask.sum()).sqrt())

    def _gradient(
        self, episodes: Tensor, batch: Sequences, parameters: list[Tensor], steps: float
    ) -> tuple[tuple[Tensor, ...], Tensor]:
        """Return the gradients of some episodes of a batch, and their share of its error."""
        loss = squared_errors(self.network, batch.of(episodes), self._dtype).sum() / steps
        return torch.autograd.grad(loss, parameters), loss.detach()

    def snapshot(self) -> dict[str, Any]:
        """Return the state for `restore`, exact to the bit."""
        return {
            "network": self.network.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "generator": self._generator.get_state(),
        }

    def restore(self, content: dict[str, Any]) -> None:
        """Restore a snapshot of a learner with the same arguments."""
        self.network.load_state_dict(content["network"])
        self._optimiser.load_state_dict(content["optimiser"])
        self._generator.set_state(content["generator"])


FRAMES = 1_000_000  # learned steps, if no end is given
VALIDATIONS = 20  # over these frames
PATIENCE = 5  # validations without improvement after which a run stops


class CloningSession(Session):
    """Session whose learner clones episodes; its simulated robots only validate."""

    def __init__(
        self,
        recipe: Recipe,
        episodes: Sequence[Demonstration],
        source: str,
        seed: int,
        out: Path,
        pool: Executor,
        resume: bool,
    ) -> None:
        """Prepare a run on episodes; `source` names their dataset in the policy's settings.

        The task's ranges are those of the episodes.

        Raises:
            ValueError: The task is no reach task, or fewer than two episodes are given.
            CheckpointError: As of `Session`.
        """
        self._episodes, self._cloning, self._source = episodes, CloningConfig(), source
        task, run, ppo, network, randomisation = prepare(recipe, seed)
        if task.goal != REACH_GOAL:
            raise ValueError(f"task {task.name!r}: the episodes have reach goals; name a reach task, such as reach")
        if len(episodes) < 2:
            raise ValueError(f"{source}: usable episodes: {len(episodes)}; allowed 2 or more: record more flights")
        frames = sum(len(episode.action) for episode in episodes)
        every = max(1, round(FRAMES / VALIDATIONS / max(1, frames)))
        run = replace(run, robots=1, validate_every=every, patience=run.patience or PATIENCE)
        model, ranged = model_file.load(recipe.model), within(task, episodes)
        super().__init__(ranged, run, ppo, out, pool, resume, model, recipe.model_name, randomisation, network)

    def _learner(self, environment: Environment | TensorEnvironment, dtype: torch.dtype) -> Cloner:
        self.settings |= flat(clone=self._cloning)
        self.settings |= {"clone.dataset": self._source, "clone.episodes": len(self._episodes)}
        return Cloner(self.network, self._episodes, self._cloning, self.pool, self.config.seed, dtype)


def within(task: ReachTask, episodes: Sequence[Demonstration]) -> ReachTask:
    """Return a task with the range of the episodes' targets and cart starts."""
    cart = Observation._fields.index("cart_position_m")
    target = len(Observation._fields)  # the goal follows the observation
    first = np.array([episode.observation[0, [target, target + 1, cart]] for episode in episodes])

    def span(values: np.ndarray) -> Range:
        return float(values.min()), float(values.max())

    y_m, z_m, start_m = map(span, first.T)
    return replace(task, target_y_m=y_m, target_z_m=z_m, cart_start_m=start_m)
