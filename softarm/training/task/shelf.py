"""The shelf task: swing the tip into a shelf, between two boards. [P]: the paper; [C]: its authors' configuration."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softarm.schemas import flights
from softarm.schemas.model import Model
from softarm.schemas.policy import SHELF_GOAL
from softarm.schemas.robot import TRAINING_PHYSICS_RATE_HZ
from softarm.training.task.environment import Environment
from softarm.training.task.randomisation import Randomisation
from softarm.training.task.reach import Range, ReachTask, Starts

Array = NDArray[np.float32]


@dataclass(frozen=True)
class ShelfTask(ReachTask):
    """Targets in a shelf with a new place in each episode; defaults: the seed's training range ([P] section 4.2)."""

    goal = SHELF_GOAL
    kind = "shelf"

    name: str = "shelf"
    target_y_m: Range = flights.SHELF_Y_M
    target_z_m: Range = flights.SHELF_Z_M
    target_depth_m: Range = flights.SHELF_DEPTH_M  # behind the shelf's front edge; negative: before it
    board_below_m: float = flights.BOARD_BELOW_M  # from the target down to the lower board's top [C]
    action_noise: float = 0.01  # [C]

    def sample_depths(self, rng: np.random.Generator, count: int) -> Array:
        """Draw depths in metres, float32 [count], uniform over the range."""
        return rng.uniform(*self.target_depth_m, count).astype(np.float32)


class ShelfEnvironment(Environment):
    """Batch of robots with a shelf each; the observation [R, 11] ends with the target's depth."""

    _arrays = (*Environment._arrays, "_depth")
    task: ShelfTask

    def _allocate(self) -> None:
        super()._allocate()
        self._depth = np.zeros(self.robots, dtype=np.float32)

    @property
    def shelf_m(self) -> Array:
        """Return y of the shelves' front edges and z of the lower boards' tops, m, [R, 2]."""
        return np.column_stack((self._target[:, 0] + self._depth, self._target[:, 1] - self.task.board_below_m))

    def reset(
        self, starts: Starts | None = None, targets_m: Array | None = None, depths_m: Array | None = None
    ) -> Array:
        """Begin an episode for every robot; `depths_m` [R] are the targets' depths, drawn if missing."""
        super().reset(starts, targets_m)
        if depths_m is not None:
            self._place(np.ones(self.robots, dtype=np.bool_), depths_m)
        return self._observe()

    def _begin(self, which: NDArray[np.bool_], starts: Starts, targets_m: Array) -> None:
        super()._begin(which, starts, targets_m)
        self._place(which, self.task.sample_depths(self.rng, self.robots))

    def _place(self, which: NDArray[np.bool_], depths_m: Array) -> None:
        """Place the shelves of some robots so that their targets have these depths."""
        self._depth[which] = depths_m[which]
        edge, board = self.shelf_m.T
        self.simulator.place_shelf(edge, board, robots=which)

    def _observe(self) -> Array:
        return np.concatenate((super()._observe(), self._depth[:, None]), axis=1)


def environment_of(
    task: ReachTask,
    robots: int,
    seed: int,
    model: Model | None = None,
    physics_rate_hz: float = TRAINING_PHYSICS_RATE_HZ,
    randomisation: Randomisation | None = None,
) -> Environment:
    """Create the environment of any task; arguments as for `Environment`."""
    kind: type = ShelfEnvironment if isinstance(task, ShelfTask) else Environment
    made: Environment = kind(task, robots, seed, model, physics_rate_hz, randomisation)
    return made
