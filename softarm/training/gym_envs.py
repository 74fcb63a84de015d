"""Gymnasium environments `SoftArmReach-v0` and `SoftArmShelf-v0`, single and vectorised (docs/training/gymnasium.md).

Importing this module registers them: `gymnasium.make("softarm.training.gym_envs:SoftArmReach-v0")`.

Actions: float32 [2] in -1..1, cart velocity and pressure over their command ranges; values outside are clipped.
Observations: float32, in the order of `schemas.policy.OBSERVATION` and the task's goal, each in its unit.
Episodes: `terminated` if the target is reached or the cart leaves the rail, `truncated` after the task's time;
`info["success"]` states success. `reset(options={"target_m": (y, z)})` sets the goal.

The vectorised environments step all robots in one call and reset in the same step (AutoresetMode.SAME_STEP).
Gymnasium's wrappers that transform observations need `autoreset_mode="NextStep"`.
"""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from softarm.schemas.model import Model
from softarm.schemas.policy import ACTION, OBSERVATION
from softarm.schemas.robot import CONTROL_RATE_HZ, TRAINING_PHYSICS_RATE_HZ
from softarm.simulator import model_file
from softarm.training.gym_picture import Picture, Pixels, View, Window, no_window
from softarm.training.run.recipe import preset
from softarm.training.task.environment import ShelfEnvironment, Step, environment_of
from softarm.training.task.reach import ReachTask, ShelfTask

Array = NDArray[np.float32]
Task = ReachTask | str | None  # a task or its name, also of an installed plug-in; None: the seed's
ModelName = Model | Path | str | None  # a model, a file or a shipped name; None: the seed's
ACTIONS = Box(-1.0, 1.0, (len(ACTION),), np.float32)
# Larger than any robot's values: observations are clipped there to stay inside the space.
_SPEED_M_S, _PRESSURE_KPA, _DEPTH_M = 50.0, (-20.0, 200.0), (-1.0, 1.0)
# Largest position error of the motion capture, with all its effects at their bounds.
_MOCAP_ERROR_M = 0.8


def _checked(action: object, shape: tuple[int, ...]) -> Array:
    """Return an action as float32. Raises TypeError or ValueError that states the value and what is allowed."""
    allowed = f"allowed is a float32 array of shape {shape}, cart velocity and pressure in -1..1"
    if not isinstance(action, np.ndarray) or action.dtype.kind != "f":
        raise TypeError(f"the action is of type {getattr(action, 'dtype', type(action).__name__)}; {allowed}")
    if action.shape != shape:
        raise ValueError(f"the action has the shape {action.shape}; {allowed}")
    rows = action.reshape(-1, shape[-1])
    if len(bad := np.flatnonzero(~np.isfinite(rows).all(axis=1))):
        robot = f" of robot {bad[0]}" if len(shape) > 1 else ""
        raise ValueError(f"the action{robot} is {rows[bad[0]].tolist()}; {allowed}. NaN: the policy has diverged")
    with np.errstate(over="ignore"):  # values beyond float32 are clipped to 1 later
        return action.astype(np.float32, copy=False)


def _one_of(name: str, value: str | None, known: list[str]) -> str | None:
    """Return the value, None included. Raises ValueError if it is unknown."""
    if value is not None and value not in known:
        raise ValueError(f"{name} is {value!r}; allowed: {', '.join(known)}")
    return value


class ReachVectorEnv(VectorEnv[Array, Array, NDArray[Any]]):
    """`SoftArmReach-v0` with many robots, stepped in one call."""

    metadata = {  # noqa: RUF012
        "autoreset_mode": AutoresetMode.SAME_STEP,
        "render_modes": ["rgb_array"],
        "render_fps": CONTROL_RATE_HZ,
    }
    kind: type[ReachTask] = ReachTask

    def __init__(
        self,
        num_envs: int = 1,
        task: Task = None,
        model: ModelName = None,
        physics_rate_hz: float = TRAINING_PHYSICS_RATE_HZ,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
    ) -> None:
        """Prepare `num_envs` robots; autoreset_mode is SAME_STEP or NEXT_STEP, the rest as for `ReachEnv`."""
        self.render_mode = _one_of("render_mode", render_mode, self.metadata["render_modes"])
        modes = [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP]
        name = autoreset_mode.value if isinstance(autoreset_mode, AutoresetMode) else autoreset_mode
        _one_of("autoreset_mode", name, [mode.value for mode in modes])
        self.metadata = {**self.metadata, "autoreset_mode": AutoresetMode(name)}
        task = preset(task) if isinstance(task, str) else self.kind() if task is None else task
        if not isinstance(task, ReachTask):
            raise TypeError(f"task is {task!r}; allowed is a {self.kind.__name__} or its name")
        if not isinstance(task, self.kind):
            raise ValueError(f"task '{task.name}' is not for this environment; allowed is a {self.kind.__name__}")
        model = model_file.load(model) if isinstance(model, str | Path) else Model() if model is None else model
        if not isinstance(model, Model):
            raise TypeError(f"model is {model!r}; allowed is a Model, a file or a shipped name")
        self.environment = environment_of(task, num_envs, 0, model, physics_rate_hz)
        self.environment.restarts = name == AutoresetMode.SAME_STEP.value
        # Arguments of a drawing.
        self.scene = (model, task.rail_limit_m, task.success_radius_m)
        self.num_envs, self._is_begun = num_envs, False
        self._over = np.zeros(num_envs, dtype=np.bool_)  # the next step begins an episode, with NEXT_STEP
        self._success = np.zeros(num_envs, dtype=np.bool_)
        self._pictures: dict[int, Picture] = {}
        self._low, self._high = self._bounds(model)
        self.single_observation_space = Box(self._low, self._high, dtype=np.float32)
        self.single_action_space = ACTIONS
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(ACTIONS, num_envs)

    def _bounds(self, model: Model) -> Array:
        """Return the lowest and the highest observation of a robot, [2, N]."""
        cart = model.cart.travel_m + 0.1
        arm, height = sum(model.arm.link_length_m) + 0.1, model.arm.base_height_m
        speed, y, z = (-_SPEED_M_S, _SPEED_M_S), (-cart - arm, cart + arm), (height - arm, height + arm)
        error = 0.0 if self.environment.sensors is None else _MOCAP_ERROR_M
        seen = [(low - error, high + error) for low, high in ((-cart, cart), y, z)]
        ranges = [seen[0], speed, *seen[1:], speed, speed, (ACTION[0].low, ACTION[0].high), _PRESSURE_KPA]
        ranges += [y, z, _DEPTH_M] if isinstance(self.environment, ShelfEnvironment) else [y, z]
        return np.array(ranges, dtype=np.float32).T

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Begin an episode for every robot. Raises ValueError for an unknown option, TypeError for several seeds."""
        if seed is not None and not isinstance(seed, int):
            raise TypeError(f"the seed is a {type(seed).__name__}; allowed is one Python integer for all robots")
        super().reset(seed=seed)
        return self.begin(self.np_random, options), {}

    def begin(self, rng: np.random.Generator, options: dict[str, Any] | None) -> Array:
        """Begin an episode for every robot with random numbers of `rng` and return the observations [R, N].

        `options` may hold `target_m` [2] or [R, 2] and, for the shelf task, `depth_m` as a scalar or [R]. Raises
        ValueError for an unknown option and a goal outside the observation space.
        """
        first = len(OBSERVATION)
        places = {"target_m": slice(first, first + 2)}
        if isinstance(self.environment, ShelfEnvironment):
            places["depth_m"] = slice(first + 2, first + 3)
        given: dict[str, Any] = {}
        for name, value in (options or {}).items():
            if name not in places:
                raise ValueError(f"unknown option {name}; this task takes {', '.join(places)}")
            shape = (self.num_envs, 2) if name == "target_m" else (self.num_envs,)
            try:
                goal = np.broadcast_to(np.asarray(value, dtype=np.float32), shape)
            except (TypeError, ValueError):
                raise ValueError(f"{name} is {value!r}; give numbers of the shape {shape[1:]} or {shape}") from None
            low, high = self._low[places[name]], self._high[places[name]]
            if not ((low <= goal) & (goal <= high)).all():
                raise ValueError(f"{name} is {value}; give something within {low} .. {high}")
            given[name.replace("_m", "s_m")] = goal
        self.environment.rng = rng
        self._is_begun, self._over[:], self._success[:] = True, False, False
        return self._seen(self.environment.reset(**given))

    def step(self, actions: Array) -> tuple[Array, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Hold actions [R, 2] for a control step; robots whose episode ends begin a new one.

        With SAME_STEP, `info["final_obs"]` and `info["final_info"]` describe the episodes that ended. Raises TypeError
        or ValueError if an action is invalid, ResetNeeded before the first reset.
        """
        return self.advance(_checked(actions, (self.num_envs, *ACTIONS.shape)))

    def advance(self, actions: Array) -> tuple[Array, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Run `step` with valid actions."""
        if not self._is_begun:
            raise ResetNeeded("step before reset: call reset() first, and after each episode's end")
        step = self.environment.step(actions)
        if not self.environment.restarts:
            step = self._restarted(step)
        self._success = step.success
        info = {"success": step.success, "_success": np.ones(self.num_envs, dtype=np.bool_)}
        if self.environment.restarts:
            last = self._seen(step.final_observation)
            for robot in np.flatnonzero(step.terminated | step.truncated).tolist():
                ended = {"final_obs": last[robot], "final_info": {"success": bool(step.success[robot])}}
                info = self._add_info(info, ended, robot)
        return self._seen(step.observation), step.reward, step.terminated, step.truncated, info

    def _restarted(self, step: Step) -> Step:
        """Replace the step of robots whose episode had ended by the first observation of a new episode."""
        continues = ~self._over
        observation = self.environment.restart(self._over) if self._over.any() else step.observation
        terminated, truncated, success = (each & continues for each in (step.terminated, step.truncated, step.success))
        self._over = terminated | truncated
        return step._replace(
            observation=np.where(self._over[:, None], step.final_observation, observation),
            reward=np.where(continues, step.reward, np.float32(0.0)),
            terminated=terminated,
            truncated=truncated,
            success=success,
        )

    def _seen(self, observation: Array) -> Array:
        """Clip observations [R, N] to the space."""
        return np.clip(observation, self._low, self._high)

    def view(self, robot: int) -> View:
        """Return the state of a robot to draw. Raises ResetNeeded without an episode."""
        if not self._is_begun:
            raise ResetNeeded("render before reset: call reset() first")
        environment, simulator = self.environment, self.environment.simulator
        shelf = environment.shelf_m[robot] if isinstance(environment, ShelfEnvironment) else None
        time_s, cart_y_m = float(environment.elapsed_s[robot]), float(simulator.cart_position_m[robot])
        target, success = environment.target_m[robot], bool(self._success[robot])
        return View(time_s, cart_y_m, simulator.link_ends_m()[robot], target, success, shelf)

    def render(self) -> tuple[Pixels, ...] | None:
        """Draw each robot from the side, uint8 [360, 640, 3]; after an episode's end, the start of the next one."""
        if self.render_mode is None:
            return None
        frames = []
        for robot in range(self.num_envs):
            view = self.view(robot)
            if robot not in self._pictures:
                self._pictures[robot] = Picture(*self.scene)
            self._pictures[robot].draw(view)
            frames.append(self._pictures[robot].pixels())
        return tuple(frames)


class ReachEnv(gymnasium.Env[Array, Array]):
    """`SoftArmReach-v0`: swing the tip of one robot to a target in free space."""

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": CONTROL_RATE_HZ}  # noqa: RUF012
    action_space = ACTIONS
    vector: type[ReachVectorEnv] = ReachVectorEnv

    def __init__(
        self,
        task: Task = None,
        model: ModelName = None,
        physics_rate_hz: float = TRAINING_PHYSICS_RATE_HZ,
        render_mode: str | None = None,
    ) -> None:
        """Prepare the robot; without a display, `metadata` does not list the render mode "human".

        Raises:
            ModelFileError: The model is missing or invalid.
            TypeError: The task or the model is of another type.
            ValueError: The task or the render mode is unknown.
            RuntimeError: The render mode is "human" and there is no display.
        """
        self.render_mode = _one_of("render_mode", render_mode, self.metadata["render_modes"])
        if no_window() is not None:
            self.metadata = {**self.metadata, "render_modes": ["rgb_array"]}
        # With NEXT_STEP the last frame shows how the episode ended.
        self._robots = self.vector(1, task, model, physics_rate_hz, "rgb_array", AutoresetMode.NEXT_STEP)
        rate_hz = self._robots.environment.task.rate_hz
        self._window = Window(*self._robots.scene, rate_hz) if render_mode == "human" else None
        self._is_over = False
        self.observation_space = self._robots.single_observation_space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Begin an episode; `options` may hold `target_m` and `depth_m`. Raises ValueError for an unknown option."""
        super().reset(seed=seed)
        observation = self._robots.begin(self.np_random, options)[0]
        self._is_over = False
        self._show()
        return observation, {"success": False}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Hold an action for a control step. Raises TypeError or ValueError if it is invalid, ResetNeeded."""
        checked = _checked(action, ACTIONS.shape)
        if self._is_over:
            raise ResetNeeded("step after the episode's end (terminated or truncated): call reset() first")
        (seen,), (reward,), (terminated,), (truncated,), info = self._robots.advance(checked[None])
        self._is_over = bool(terminated or truncated)
        self._show()
        return seen, float(reward), bool(terminated), bool(truncated), {"success": bool(info["success"][0])}

    def render(self) -> Pixels | None:
        """Draw the robot from the side, uint8 [360, 640, 3]; with "human" the window needs no call."""
        if self.render_mode is None:
            gymnasium.logger.warn("render without a render_mode: make the environment with render_mode='rgb_array'")
        frames = self._robots.render() if self.render_mode == "rgb_array" else None
        return None if frames is None else frames[0]

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()

    def _show(self) -> None:
        if self._window is not None:
            self._window.show(self._robots.view(0))


class ShelfVectorEnv(ReachVectorEnv):
    """`SoftArmShelf-v0` with many robots, stepped in one call."""

    kind = ShelfTask


class ShelfEnv(ReachEnv):
    """`SoftArmShelf-v0`: swing the tip of one robot into a shelf, between two boards."""

    vector = ShelfVectorEnv


for _task in ("Reach", "Shelf"):
    gymnasium.register(
        f"SoftArm{_task}-v0",
        entry_point=f"softarm.training.gym_envs:{_task}Env",
        vector_entry_point=f"softarm.training.gym_envs:{_task}VectorEnv",
    )
