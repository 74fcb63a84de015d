"""The tasks as Gymnasium environments: `SoftArmReach-v0`, `SoftArmShelf-v0`, single and vectorised (docs/gymnasium.md).

Importing this registers them; `gymnasium.make("softarm.training.gym_envs:SoftArmReach-v0")` imports it.

Actions, float32 [2] in -1..1: cart velocity and pressure over their command ranges; what lies outside is cut.
Observations, float32, in the order of `schemas.policy.OBSERVATION` and the task's goal, each in its unit. Rewards and
episodes are the task's: `terminated` where the target is reached or the cart is off the rail, `truncated` where the
time is over; `info` has `success`. The vectorised ones step all robots in one call of the kernel and reset in the same
step (AutoresetMode.SAME_STEP): where an episode ended, `info["final_obs"]` has its last observation and
`info["final_info"]` its success. Gymnasium's wrappers that transform observations want `autoreset_mode="NextStep"`.
Where the goal lies may be given to `reset`, as options.
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
from softarm.training.gym_picture import Picture, Pixels, View, Window
from softarm.training.run.recipe import preset
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
        self.model = model_file.load(model) if isinstance(model, str | Path) else model or Model()
        self.environment = environment_of(task, robots, 0, self.model, physics_rate_hz)
        self.success = np.zeros(robots, dtype=np.bool_)
        self.is_begun = False
        self._pictures: dict[int, Picture] = {}
        cart = self.model.cart.travel_m + 0.1
        arm, height = sum(self.model.arm.link_length_m) + 0.1, self.model.arm.base_height_m
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
        self.is_begun, self.success[:] = True, False
        return self.seen(self.environment.reset(**given))

    def step(self, actions: Array) -> Step:
        """Hold actions [R, 2] for a control step. Raises ResetNeeded before the first `begin`."""
        if not self.is_begun:
            raise ResetNeeded("step before reset: call reset() first, and after each episode's end")
        step = self.environment.step(actions)
        self.success = step.success
        return step

    def seen(self, observation: Array) -> Array:
        """Observations [R, N] as the space promises them."""
        return np.clip(observation, self._low, self._high)

    def view(self, robot: int) -> View:
        """What there is to be seen of a robot. Raises ResetNeeded before the first `begin`."""
        if not self.is_begun:
            raise ResetNeeded("render before reset: there is nothing to be seen yet; call reset() first")
        environment, simulator = self.environment, self.environment.simulator
        shelf = environment.shelf_m[robot] if isinstance(environment, ShelfEnvironment) else None
        time_s, cart_y_m = float(environment.elapsed_s[robot]), float(simulator.cart_position_m[robot])
        target, success = environment.target_m[robot], bool(self.success[robot])
        return View(time_s, cart_y_m, simulator.link_ends_m()[robot], target, success, shelf)

    def window(self) -> Window:
        """Where one robot is shown. Raises RuntimeError where there is no display."""
        task = self.environment.task
        return Window(self.model, task.rail_limit_m, task.success_radius_m, task.rate_hz)

    def pixels(self, robot: int) -> Pixels:
        """A robot from the side, uint8 [360, 640, 3]."""
        if robot not in self._pictures:
            task = self.environment.task
            self._pictures[robot] = Picture(self.model, task.rail_limit_m, task.success_radius_m)
        picture = self._pictures[robot]
        picture.draw(self.view(robot))
        return picture.pixels()


def _checked(action: object, shape: tuple[int, ...]) -> Array:
    """An action as the simulator takes it. Raises TypeError or ValueError that says what it is and what is allowed."""
    if not isinstance(action, np.ndarray):
        kind = f"{type(action).__module__}.{type(action).__name__}".removeprefix("builtins.")
        raise TypeError(
            f"the action is a {kind}; allowed is a float32 array of shape {shape}: numpy.asarray(action, numpy.float32)"
        )
    if action.dtype.kind != "f":
        raise TypeError(f"the action's numbers are {action.dtype}; allowed is float32: action.astype(numpy.float32)")
    if action.shape != shape:
        raise ValueError(
            f"the action has the shape {action.shape}; allowed is {shape}: cart velocity and pressure in -1..1"
            + (", a row for each robot" if len(shape) > 1 else "")
        )
    if not np.isfinite(action).all():
        rows = np.flatnonzero(~np.isfinite(action).reshape(-1, shape[-1]).all(axis=1))
        which = f" of robot {rows[0]}" if len(shape) > 1 else ""
        values = action.reshape(-1, shape[-1])[rows[0]].tolist()
        raise ValueError(
            f"the action{which} is {values}; allowed are numbers in -1..1: a policy that gives NaN has diverged, lower "
            "its learning rate or look at what it was fed"
        )
    with np.errstate(over="ignore"):  # beyond float32 is beyond 1, where it is cut
        return action.astype(np.float32, copy=False)


def _known_mode(mode: str | None, modes: list[str]) -> str | None:
    """A render mode that there is. Raises ValueError."""
    if mode is not None and mode not in modes:
        raise ValueError(f"render_mode is {mode!r}; allowed: {', '.join(modes)}, or None to draw nothing")
    return mode


def _task_of(task: ReachTask | str, kind: type[ReachTask]) -> ReachTask:
    """A task, or one by its name. Raises ValueError for none, or one of another kind."""
    found = preset(task) if isinstance(task, str) else task
    if not isinstance(found, kind):
        raise ValueError(f"task '{found.name}' is not for this environment; allowed is a {kind.__name__}")
    return found


def _known_autoreset(mode: AutoresetMode | str) -> AutoresetMode:
    """When robots begin again. Raises ValueError for a way that there is not."""
    known = {each.value: each for each in (AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP)}
    if (name := mode.value if isinstance(mode, AutoresetMode) else mode) not in known:
        raise ValueError(f"autoreset_mode is {name!r}; allowed: {', '.join(known)}")
    return known[name]


class _SingleEnv(gymnasium.Env[Array, Array]):
    """One robot."""

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": CONTROL_RATE_HZ}  # noqa: RUF012
    action_space = ACTIONS

    def __init__(
        self, task: ReachTask, model: Model | Path | str | None, physics_rate_hz: float, render_mode: str | None
    ) -> None:
        self.render_mode = _known_mode(render_mode, self.metadata["render_modes"])
        self._batch = _Batch(task, 1, model, physics_rate_hz)
        self._batch.environment.restarts = False  # what a person sees last is how the episode ended
        self._window = self._batch.window() if render_mode == "human" else None
        self._is_over = False
        self.observation_space = self._batch.space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Begin an episode; options: `_Batch.begin`. Raises ValueError for an unknown option."""
        super().reset(seed=seed)
        observation = self._batch.begin(self.np_random, options)[0]
        self._is_over = False
        self._show()
        return observation, {"success": False}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Hold an action for a control step.

        Raises TypeError or ValueError for what is no action, ResetNeeded after the end of an episode.
        """
        checked = _checked(action, ACTIONS.shape)
        if self._is_over:
            raise ResetNeeded("step after the episode's end (terminated or truncated): call reset() first")
        step = self._batch.step(checked[None])
        info = {"success": bool(step.success[0])}
        seen, terminated = self._batch.seen(step.final_observation)[0], bool(step.terminated[0])
        truncated = bool(step.truncated[0])
        self._is_over = terminated or truncated
        self._show()
        return seen, float(step.reward[0]), terminated, truncated, info

    def render(self) -> Pixels | None:
        """The robot from the side, uint8 [360, 640, 3], with rgb_array; a window shows it by itself."""
        if self.render_mode is None:
            gymnasium.logger.warn("render without a render_mode: make the environment with render_mode='rgb_array'")
        return self._batch.pixels(0) if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Close the window."""
        if self._window is not None:
            self._window.close()

    def _show(self) -> None:
        if self._window is not None:
            self._window.show(self._batch.view(0))


class _ManyEnv(VectorEnv[Array, Array, NDArray[Any]]):
    """Many robots in one call."""

    metadata = {  # noqa: RUF012
        "autoreset_mode": AutoresetMode.SAME_STEP,
        "render_modes": ["rgb_array"],
        "render_fps": CONTROL_RATE_HZ,
    }

    def __init__(
        self,
        task: ReachTask,
        num_envs: int,
        model: Model | Path | str | None,
        physics_rate_hz: float,
        render_mode: str | None,
        autoreset_mode: AutoresetMode | str,
    ) -> None:
        self.render_mode = _known_mode(render_mode, self.metadata["render_modes"])
        mode = _known_autoreset(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": mode}
        self.num_envs = num_envs
        self._batch = _Batch(task, num_envs, model, physics_rate_hz)
        self._batch.environment.restarts = mode is AutoresetMode.SAME_STEP
        self._over = np.zeros(num_envs, dtype=np.bool_)  # whose next step begins an episode, where they do not at once
        self.single_observation_space, self.single_action_space = self._batch.space, ACTIONS
        self.observation_space = batch_space(self._batch.space, num_envs)
        self.action_space = batch_space(ACTIONS, num_envs)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Begin an episode everywhere; options: `_Batch.begin`.

        Raises ValueError for an unknown option, TypeError for a seed that is no integer.
        """
        if seed is not None and not isinstance(seed, int):
            raise TypeError(
                f"the seed is a {type(seed).__name__}; allowed is one integer: all robots are drawn from one generator"
            )
        super().reset(seed=seed)
        self._over[:] = False
        return self._batch.begin(self.np_random, options), {}

    def step(self, actions: Array) -> tuple[Array, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Hold actions [R, 2] for a control step; robots whose episode ends begin a new one.

        Raises TypeError or ValueError for what are no actions, ResetNeeded before the first `reset`.
        """
        step = self._batch.step(_checked(actions, (self.num_envs, *ACTIONS.shape)))
        if self.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP:
            step = self._begun_anew(step)
            info = {"success": step.success, "_success": np.ones(self.num_envs, dtype=np.bool_)}
            return self._batch.seen(step.observation), step.reward, step.terminated, step.truncated, info
        info = {"success": step.success, "_success": np.ones(self.num_envs, dtype=np.bool_)}
        info |= self._final(step)
        return self._batch.seen(step.observation), step.reward, step.terminated, step.truncated, info

    def render(self) -> tuple[Pixels, ...] | None:
        """Each robot from the side, uint8 [360, 640, 3], with rgb_array; of robots that began anew, their beginning."""
        if self.render_mode is None:
            return None
        return tuple(self._batch.pixels(robot) for robot in range(self.num_envs))

    def _begun_anew(self, step: Step) -> Step:
        """A step in which robots whose episode had ended began another one instead: what they did meanwhile is none."""
        anew, goes_on = self._over, ~self._over
        observation = self._batch.environment.restart(anew) if anew.any() else step.observation
        terminated, truncated, success = (each & goes_on for each in (step.terminated, step.truncated, step.success))
        self._over = terminated | truncated
        observation = np.where(self._over[:, None], step.final_observation, observation)
        self._batch.success = success
        return step._replace(
            observation=observation,
            reward=np.where(goes_on, step.reward, np.float32(0.0)),
            terminated=terminated,
            truncated=truncated,
            success=success,
        )

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
        task: ReachTask | str | None = None,
        model: Model | Path | str | None = None,
        physics_rate_hz: float = TRAINING_PHYSICS_RATE_HZ,
        render_mode: str | None = None,
    ) -> None:
        """task: one, or its name, an installed plugin's among them (default: the seed's); model: a `Model`, a file or
        a shipped name. Raises ModelFileError, and ValueError for a task that there is not.
        """
        super().__init__(_task_of(task or ReachTask(), ReachTask), model, physics_rate_hz, render_mode)


class ReachVectorEnv(_ManyEnv):
    """`SoftArmReach-v0`, many robots."""

    def __init__(
        self,
        num_envs: int = 1,
        task: ReachTask | str | None = None,
        model: Model | Path | str | None = None,
        physics_rate_hz: float = TRAINING_PHYSICS_RATE_HZ,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
    ) -> None:
        """As `ReachEnv`; autoreset_mode: SAME_STEP or NEXT_STEP, as Gymnasium means them."""
        super().__init__(
            _task_of(task or ReachTask(), ReachTask), num_envs, model, physics_rate_hz, render_mode, autoreset_mode
        )


class ShelfEnv(_SingleEnv):
    """`SoftArmShelf-v0`: swing the tip into a shelf, between two boards."""

    def __init__(
        self,
        task: ShelfTask | str | None = None,
        model: Model | Path | str | None = None,
        physics_rate_hz: float = TRAINING_PHYSICS_RATE_HZ,
        render_mode: str | None = None,
    ) -> None:
        """As `ReachEnv`."""
        super().__init__(_task_of(task or ShelfTask(), ShelfTask), model, physics_rate_hz, render_mode)


class ShelfVectorEnv(_ManyEnv):
    """`SoftArmShelf-v0`, many robots."""

    def __init__(
        self,
        num_envs: int = 1,
        task: ShelfTask | str | None = None,
        model: Model | Path | str | None = None,
        physics_rate_hz: float = TRAINING_PHYSICS_RATE_HZ,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
    ) -> None:
        """As `ReachEnv`; autoreset_mode: SAME_STEP or NEXT_STEP, as Gymnasium means them."""
        super().__init__(
            _task_of(task or ShelfTask(), ShelfTask), num_envs, model, physics_rate_hz, render_mode, autoreset_mode
        )


for _task in ("Reach", "Shelf"):
    gymnasium.register(
        f"SoftArm{_task}-v0",
        entry_point=f"softarm.training.gym_envs:{_task}Env",
        vector_entry_point=f"softarm.training.gym_envs:{_task}VectorEnv",
    )
