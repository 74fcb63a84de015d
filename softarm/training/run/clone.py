"""Training run that clones recorded episodes, with the files, validation and report of any other run."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from softarm.schemas.policy import REACH_GOAL, Observation
from softarm.simulator import model_file
from softarm.training.learn.cloning import Cloner, CloningConfig, Demonstration
from softarm.training.record.settings import flat
from softarm.training.run.recipe import Recipe, prepare
from softarm.training.run.session import Session
from softarm.training.task.environment import Environment
from softarm.training.task.reach import Range, ReachTask
from softarm.training.task.tensor_environment import TensorEnvironment

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
        model, name = model_file.load(recipe.model), Path(recipe.model).stem
        super().__init__(within(task, episodes), run, ppo, out, pool, resume, model, name, randomisation, network)

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
