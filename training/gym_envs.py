"""The tasks as Gymnasium environments: `SoftArmReach-v0`, `SoftArmShelf-v0`, single and vectorised.

Importing this registers them; `gymnasium.make("softarm.training.gym_envs:SoftArmReach-v0")` imports it.

Actions, float32 [2] in -1..1: cart velocity and pressure over their command ranges. Observations, float32, in the order
of `schemas.policy.OBSERVATION` and the task's goal, each in its unit. Rewards and episodes are the task's; `info`
has `success`. The vectorised ones step all robots in one call of the kernel and reset in the same step
(AutoresetMode.SAME_STEP): where an episode ended, `info["final_obs"]` has its last observation and
`info["final_info"]` its success. Where the goal lies may be given to `reset`, as options.
"""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from softarm.schemas.model import Model
from softarm.schemas.policy import ACTION, OBSERVATION
from softarm.schemas.robot import TRAINING_PHYSICS_RATE_HZ
from softarm.simulator import model_file
from softarm.training.task.environment import Step
from softarm.training.task.reach import ReachTask
from softarm.training.task.shelf import ShelfEnvironment, ShelfTask, environment_of

Array = NDArray[np.float32]
ACTIONS = Box(-1.0, 1.0, (len(ACTION),), np.float32)
# Beyond what any robot of the kind does: observations are cut there, so that the space keeps its word.
_SPEED_M_S, _PRESSURE_KPA, _DEPTH_M = 50.0, (-20.0, 200.0), (-1.0, 1.0)
# How far beside a point the mocap may show it: turned, stretched, shifted and noisy, all at the registry's bounds.
_ASIDE_M = 0.8


class _Batch:
    """Robots at a task, and the space of one robot's observations."""

    def __init__(self, task: ReachTask, robots: int, model: Model | Path | str | None, physics_rate_hz: float) -> None:
        """Raises ModelFileError for a bad model file."""
        loaded = model_file.load(model) if isinstance(model, str | Path) else model or Model()
        self.environment = environment_of(task, robots, 0, loaded, physics_rate_hz)
        cart = loaded.cart.travel_m + 0.1
        arm, height = sum(loaded.arm.link_length_m) + 0.1, loaded.arm.base_height_m
        speed, y, z = (-_SPEED_M_S, _SPEED_M_S), (-cart - arm, cart + arm), (height - arm, height + arm)
        aside = 0.0 if self.environment.sensors is None else _ASIDE_M
        seen = [(low - aside, high + aside) for low, high in ((-cart, cart), y, z)]
        ranges = [seen[0], speed, *seen[1:], speed, speed, (ACTION[0].low, ACTION[0].high), _PRESSURE_KPA]
        ranges += [y, z, _DEPTH_M] if isinstance(task, ShelfTask) else [y, z]
        self._low, self._high = np.array(ranges, dtype=np.float32).T
        self.space = Box(self._low, self._high, dtype=np.float32)

    def begin(self, rng: np.random.Generator, options: dict[str, Any] | None) -> Array:
        """Begin an episode everywhere; options: `target_m` [2] or [R, 2] and, of a shelf, `depth_m` scalar or [R].

        Raises ValueError for an option that the task does not have, or a goal outside the observation space.
        """
        robots, first = self.environment.robots, len(OBSERVATION)
        places: dict[str, tuple[str, tuple[int, ...], slice]] = {
            "target_m": ("targets_m", (robots, 2), slice(first, first + 2))
        }
        if isinstance(self.environment, ShelfEnvironment):
            places["depth_m"] = ("depths_m", (robots,), slice(first + 2, first + 3))
        given: dict[str, Any] = {}
        for name, value in (options or {}).items():
            if name not in places:
                raise ValueError(f"unknown option {name}; this task takes {', '.join(places)}")
            key, shape, goal = places[name]
            given[key] = np.broadcast_to(np.asarray(value, dtype=np.float32), shape)
            low, high = self._low[goal], self._high[goal]
            if not ((low <= given[key]) & (given[key] <= high)).all():
                raise ValueError(f"{name} is {value}; give something within {low} .. {high}")
        self.environment.rng = rng
        return self.seen(self.environment.reset(**given))

    def step(self, actions: Array) -> Step:
        """Hold actions [R, 2] for a control step."""
        return self.environment.step(np.asarray(actions, dtype=np.float32))

    def seen(self, observation: Array) -> Array:
        """Observations [R, N] as the space promises them."""
        return np.clip(observation, self._low, self._high)


class _SingleEnv(gymnasium.Env[Array, Array]):
    """One robot."""

    metadata = {"render_modes": []}  # noqa: RUF012
    action_space = ACTIONS

    def __init__(self, task: ReachTask, model: Model | Path | str | None, physics_rate_hz: float) -> None:
        self._batch = _Batch(task, 1, model, physics_rate_hz)
        self.observation_space = self._batch.space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Begin an episode; options: `_Batch.begin`. Raises ValueError for an unknown option."""
        super().reset(seed=seed)
        return self._batch.begin(self.np_random, options)[0], {"success": False}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Hold an action for a control step; after the end of an episode comes a `reset`."""
        step = self._batch.step(action[None])
        info = {"success": bool(step.success[0])}
        seen = self._batch.seen(step.final_observation)[0]
        return seen, float(step.reward[0]), bool(step.terminated[0]), bool(step.truncated[0]), info


class _ManyEnv(VectorEnv[Array, Array, NDArray[Any]]):
    """Many robots in one call."""

    metadata = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": []}  # noqa: RUF012

    def __init__(
        self, task: ReachTask, num_envs: int, model: Model | Path | str | None, physics_rate_hz: float
    ) -> None:
        self.num_envs = num_envs
        self._batch = _Batch(task, num_envs, model, physics_rate_hz)
        self.single_observation_space, self.single_action_space = self._batch.space, ACTIONS
        self.observation_space = batch_space(self._batch.space, num_envs)
        self.action_space = batch_space(ACTIONS, num_envs)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Begin an episode everywhere; options: `_Batch.begin`. Raises ValueError for an unknown option."""
        super().reset(seed=seed)
        return self._batch.begin(self.np_random, options), {}

    def step(self, actions: Array) -> tuple[Array, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Hold actions [R, 2] for a control step; robots whose episode ends begin a new one."""
        step = self._batch.step(actions)
        info = {"success": step.success, "_success": np.ones(self.num_envs, dtype=np.bool_)}
        info |= self._final(step)
        return self._batch.seen(step.observation), step.reward, step.terminated, step.truncated, info

    def _final(self, step: Step) -> dict[str, Any]:
        """What Gymnasium wants to know of the episodes that ended in a step."""
        over = step.terminated | step.truncated
        if not over.any():
            return {}
        final = np.full(self.num_envs, None, dtype=object)
        seen = self._batch.seen(step.final_observation)
        for robot in np.flatnonzero(over):
            final[robot] = seen[robot]
        ended = {"success": step.success & over, "_success": over}
        return {"final_obs": final, "_final_obs": over, "final_info": ended, "_final_info": over}


class ReachEnv(_SingleEnv):
    """`SoftArmReach-v0`: swing the tip to a target in free space."""

    def __init__(
        self,
        task: ReachTask | None = None,
        model: Model | Path | str | None = None,
        physics_rate_hz: float = TRAINING_PHYSICS_RATE_HZ,
    ) -> None:
        """Default task: the seed's; model: a `Model`, a file or a shipped name. Raises ModelFileError."""
        super().__init__(task or ReachTask(), model, physics_rate_hz)


class ReachVectorEnv(_ManyEnv):
    """`SoftArmReach-v0`, many robots."""

    def __init__(
        self,
        num_envs: int = 1,
        task: ReachTask | None = None,
        model: Model | Path | str | None = None,
        physics_rate_hz: float = TRAINING_PHYSICS_RATE_HZ,
    ) -> None:
        """As `ReachEnv`."""
        super().__init__(task or ReachTask(), num_envs, model, physics_rate_hz)


class ShelfEnv(_SingleEnv):
    """`SoftArmShelf-v0`: swing the tip into a shelf, between two boards."""

    def __init__(
        self,
        task: ShelfTask | None = None,
        model: Model | Path | str | None = None,
        physics_rate_hz: float = TRAINING_PHYSICS_RATE_HZ,
    ) -> None:
        """As `ReachEnv`."""
        super().__init__(task or ShelfTask(), model, physics_rate_hz)


class ShelfVectorEnv(_ManyEnv):
    """`SoftArmShelf-v0`, many robots."""

    def __init__(
        self,
        num_envs: int = 1,
        task: ShelfTask | None = None,
        model: Model | Path | str | None = None,
        physics_rate_hz: float = TRAINING_PHYSICS_RATE_HZ,
    ) -> None:
        """As `ReachEnv`."""
        super().__init__(task or ShelfTask(), num_envs, model, physics_rate_hz)


for _task in ("Reach", "Shelf"):
    gymnasium.register(
        f"SoftArm{_task}-v0",
        entry_point=f"softarm.training.gym_envs:{_task}Env",
        vector_entry_point=f"softarm.training.gym_envs:{_task}VectorEnv",
    )
