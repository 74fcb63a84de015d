"""Batch environment: many robots at one task, with observations, rewards and automatic restarts.

With effects of the sensors (mocap.*, pressure.sensor_bias, clock.drift), observations pass `simulator.sensors.Sensors`;
with effects of the clock (clock.*), control loops tick late or not at all. Rewards, success, the end of an episode and
the rail guard use the true state.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from softarm.policies.base import HIGH, LOW
from softarm.schemas.model import Model
from softarm.schemas.policy import ACTION, REACH_GOAL, Observation, places
from softarm.schemas.robot import TRAINING_PHYSICS_RATE_HZ
from softarm.simulator.effects import EffectError, find, out_of_range
from softarm.simulator.model_file import idle_effects
from softarm.simulator.sensors import Clock, Sensors
from softarm.simulator.simulator import Simulator
from softarm.training.task import calls
from softarm.training.task.rail_guard import RailGuard
from softarm.training.task.reach import Moment, ReachTask, ShelfTask, Starts

Draw = dict[str, NDArray[np.float64]]  # 'stage.effect.parameter' -> one value a robot, [R]


@dataclass(frozen=True)
class Randomisation:
    """Ranges to draw from, and how often; without ranges nothing is drawn."""

    # 'stage.effect.parameter' -> lowest and highest value, in its unit; effects that the model lacks are added
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    each_episode: bool = False  # draw again for each episode of a robot, else only once

    def __post_init__(self) -> None:
        """Check the ranges. Raises EffectError for an unknown or invalid effect, ValueError for a reversed range."""
        for path, (low, high) in self.ranges.items():
            effect, parameter = find(path)
            for end in (low, high):
                if not parameter.admits(end):
                    raise EffectError(out_of_range(effect, parameter, end))
            if not low <= high < np.inf:
                raise ValueError(f"{path} has the range {low} to {high}; give a lower and a higher finite end")

    def effects_with(self, model: Model) -> set[str]:
        """Return the effects of a model that are not at their neutral value, and those that are drawn."""
        return (model.effects.keys() - idle_effects(model)) | {path.rpartition(".")[0] for path in self.ranges}

    def draw(self, rng: np.random.Generator, robots: int) -> Draw:
        """Draw values for a number of robots; empty without ranges."""
        return {path: rng.uniform(low, high, robots) for path, (low, high) in self.ranges.items()}


Array = NDArray[np.float32]
Mask = NDArray[np.bool_]

INPUTS = len(Observation._fields) + len(REACH_GOAL)
ACTIONS = len(ACTION)
SEEN = places("cart_position_m", "tip_y_m", "tip_z_m", "cart_velocity_m_s", "tip_vy_m_s", "tip_vz_m_s")
SENT, PRESSURE = places("previous_cart_velocity_command_m_s", "pressure_kpa")
SEEN_THROUGH = ("pressure.sensor_bias", "clock.drift")  # effects of the sensors, in addition to mocap.*
_ARRAYS_OF_EFFECTS = ("_seen", "_sent_kpa")
# A separate generator draws the differences between the robots.
DIFFERENCES = 7919


class Step(NamedTuple):
    """Result of a step, one entry per robot."""

    observation: Array  # [R, 10], of the new episode where one ended
    reward: Array  # [R], scaled
    terminated: Mask  # reached, or off the rail
    truncated: Mask  # out of time
    success: Mask
    final_observation: Array  # [R, 10], before any restart
    final_tip_m: Array  # [R, 2], true tip position then


def distorts(effect: str) -> bool:
    """Return whether an effect changes what a policy observes of the state."""
    return effect.startswith("mocap.") or effect in SEEN_THROUGH


def to_physical(action: Array) -> Array:
    """Map actions in -1..1, float32 [..., 2], to cart velocity (m/s) and pressure (kPa)."""
    return LOW + (np.clip(action, -1.0, 1.0) + 1.0) * (0.5 * (HIGH - LOW))


class Environment:
    """Batch of robots at one task. Arrays are copies; one seeded generator draws all random numbers."""

    restarts = True  # False: robots whose episode has ended stay as they are until `reset`
    _arrays: tuple[str, ...] = ("_target", "_elapsed", "_sent", "_pose", "_rates")  # of a snapshot

    def __init__(
        self,
        task: ReachTask,
        robots: int,
        seed: int,
        model: Model | None = None,
        physics_rate_hz: float = TRAINING_PHYSICS_RATE_HZ,
        randomisation: Randomisation | None = None,
    ) -> None:
        """Create robots of one model (default: the seed's) that differ by the randomisation."""
        self.task = task
        self.randomisation = randomisation or Randomisation()
        self.robots = robots
        self.inputs = len(Observation._fields) + len(task.goal)  # width of an observation
        self._rng = np.random.default_rng(seed)
        self._drawn: Draw = self.randomisation.draw(np.random.default_rng((seed, DIFFERENCES)), robots)
        self.simulator = Simulator(model, robots=robots, physics_rate_hz=physics_rate_hz, overrides=self._drawn)
        # Effects at their neutral value need no sensors.
        effects = self.randomisation.effects_with(self.simulator.model)
        self.sensors = Sensors(self.simulator, self._rng) if any(map(distorts, effects)) else None
        self.clock = Clock(self.simulator, self._rng) if any(name.startswith("clock.") for name in effects) else None
        self._differenced = "observation.finite_difference" in self.simulator.model.effects
        self._guard = RailGuard(robots, 1.0 / task.rate_hz, task.rail_limits) if task.rail_guard else None
        self._allocate()

    def _allocate(self) -> None:
        """Create the arrays with the state of every robot."""
        robots = self.robots
        self._target = np.zeros((robots, 2), dtype=np.float32)
        self._elapsed = np.zeros(robots, dtype=np.int64)
        self._sent = np.zeros(robots, dtype=np.float32)
        self._pose = np.zeros((robots, 3), dtype=np.float32)  # cart y, tip y, tip z
        self._rates = np.zeros((robots, 3), dtype=np.float32)
        self._seen = np.zeros((robots, 6), dtype=np.float32)  # pose and rates through the sensors
        self._sent_kpa = np.zeros(robots, dtype=np.float32)  # the clock's

    @property
    def rng(self) -> np.random.Generator:
        """Generator of starts, targets, noise and the effects of sensors and clocks; may be replaced."""
        return self._rng

    @rng.setter
    def rng(self, rng: np.random.Generator) -> None:
        self._rng = rng
        for each in (self.sensors, self.clock):
            if each is not None:
                each.rng = rng

    @property
    def target_m(self) -> Array:
        """Targets y, z of the current episodes, m, [R, 2]."""
        return self._target.copy()

    @property
    def elapsed_s(self) -> NDArray[np.float64]:
        """Time since the start of the current episodes, s, [R]."""
        return self._elapsed / self.task.rate_hz

    def reset(self, starts: Starts | None = None, targets_m: Array | None = None) -> Array:
        """Begin an episode for every robot and return the observation [R, 10]; missing values are drawn by the task."""
        everyone = np.ones(self.robots, dtype=np.bool_)
        links = self.simulator.links
        self._begin(
            everyone,
            starts or calls.starts(self.task, self.rng, self.robots, links),
            calls.targets(self.task, self.rng, self.robots) if targets_m is None else targets_m,
        )
        return self._observe()

    def restart(self, which: Mask) -> Array:
        """Begin an episode for some robots, booleans [R], and return the observation of all, [R, 10]."""
        self._restart(which)
        return self._observe()

    def stagger(self) -> None:
        """Spread the ages of the episodes evenly, so that they do not all end at once."""
        self._elapsed[:] = self.rng.integers(0, self.task.episode_steps, self.robots)

    def step(self, action: Array) -> Step:
        """Hold an action, float32 [R, 2] in -1..1, for a control step; robots whose episode ends begin a new one."""
        noise = self.task.action_noise * self.rng.standard_normal(action.shape, dtype=np.float32)
        velocity, pressure = to_physical(action + noise).T
        simulator, late_s = self.simulator, None
        if self._guard is not None:
            velocity = self._guard.apply(velocity, simulator.cart_position_m, simulator.cart_velocity_m_s)
        if not self.task.muscle:
            pressure = np.zeros_like(pressure)
        if self.clock is not None:
            late_s, ticks = self.clock.tick()
            velocity, pressure = self._kept(ticks, velocity, pressure)
        self._sent = velocity
        simulator.step(velocity, pressure, 1.0 / self.task.rate_hz, late_s=late_s)
        self._look()
        self._see()
        self._elapsed += 1

        tip = self._pose[:, 1:]
        # NaN ends the episode like a crash, so that it cannot spread.
        off_rail = ~(np.abs(self._pose[:, 0]) <= self.task.rail_limit_m)
        success = calls.succeeded(self.task, tip, self._target) & ~off_rail
        terminated = success | off_rail
        truncated = ~terminated & (self._elapsed >= self.task.episode_steps)
        speed = np.nan_to_num(np.linalg.norm(self._rates[:, 1:], axis=1))
        final, final_tip = np.nan_to_num(self._observe()), np.nan_to_num(tip)
        cart = np.nan_to_num(self._pose[:, 0])
        reward = calls.reward(self.task, Moment(final_tip, speed, self.target_m, cart, success, off_rail))
        if self.restarts:
            self._restart(terminated | truncated)
        return Step(self._observe(), reward, terminated, truncated, success, final, final_tip)

    def snapshot(self) -> dict[str, Any]:
        """Return the state of all robots and of the generator, as tensors and plain values."""
        arrays = {name: torch.from_numpy(getattr(self, name).copy()) for name in self._arrays}
        guard = None if self._guard is None else torch.from_numpy(self._guard.sent_m_s)
        simulator = torch.from_numpy(self.simulator.snapshot())
        rng = json.dumps(self.rng.bit_generator.state)
        drawn = {path: torch.from_numpy(values) for path, values in self._drawn.items()}
        effects = self._effects_snapshot()
        return {**arrays, "guard": guard, "simulator": simulator, "rng": rng, "effects": effects, "drawn": drawn}

    def restore(self, content: dict[str, Any]) -> None:
        """Restore a snapshot of an environment with the same arguments."""
        for name in self._arrays:
            setattr(self, name, content[name].numpy().copy())
        if self._guard is not None:
            self._guard.sent_m_s = content["guard"].numpy().copy()
        self._drawn = {path: values.numpy().copy() for path, values in content["drawn"].items()}
        if self._drawn:
            self.simulator.override(self._drawn)
        self.simulator.restore(content["simulator"].numpy())
        self.rng.bit_generator.state = json.loads(content["rng"])
        effects = {name: each.numpy().copy() for name, each in content["effects"].items()}
        if effects:
            self.simulator.time_s = float(effects.pop("time_s"))
            for name in _ARRAYS_OF_EFFECTS:
                setattr(self, name, effects.pop(name))
        if self.sensors is not None:
            self.sensors.restore(effects)

    def _effects_snapshot(self) -> dict[str, torch.Tensor]:
        """Return the state of sensors and clocks for a snapshot; empty if the model has no such effect."""
        if self.sensors is None and self.clock is None:
            return {}
        arrays = {name: getattr(self, name).copy() for name in _ARRAYS_OF_EFFECTS}
        seen = {} if self.sensors is None else self.sensors.snapshot()
        arrays |= {"time_s": np.array(self.simulator.time_s)} | seen
        return {name: torch.from_numpy(each) for name, each in arrays.items()}

    def _kept(self, ticks: Mask, velocity: Array, pressure: Array) -> tuple[Array, Array]:
        """Return the commands (m/s, kPa, [R]); loops that miss their tick keep the last ones."""
        velocity = np.where(ticks, velocity, self._sent)
        self._sent_kpa = np.where(ticks, pressure, self._sent_kpa)
        if self._guard is not None:
            self._guard.replace(velocity)
        return velocity, self._sent_kpa

    def _restart(self, over: Mask) -> None:
        if over.any():
            # Drawn for all robots, so that a robot's start does not depend on how many restart.
            starts = calls.starts(self.task, self.rng, self.robots, self.simulator.links)
            self._begin(over, starts, calls.targets(self.task, self.rng, self.robots))

    def _begin(self, which: Mask, starts: Starts, targets_m: Array) -> None:
        if self._drawn and self.randomisation.each_episode:
            new = self.randomisation.draw(self.rng, self.robots)
            self._drawn = {path: np.where(which, new[path], old) for path, old in self._drawn.items()}
            self.simulator.override(self._drawn)
        self.simulator.reset(robots=which, **starts._asdict())
        if self._guard is not None:
            self._guard.reset(which)
        self._target[which] = targets_m[which]
        self._elapsed[which] = 0
        self._sent = np.where(which, np.float32(0.0), self._sent)
        pose = self._measure()
        self._pose[which] = pose[which]
        self._rates[which] = 0.0
        self._sent_kpa = np.where(which, starts.pressure_kpa, self._sent_kpa)
        if self.sensors is not None:
            self.sensors.reset(which)
            self._see(which)

    def _measure(self) -> Array:
        return np.column_stack((self.simulator.cart_position_m, self.simulator.tip_m()))

    def _look(self) -> None:
        pose = self._measure()
        if self._differenced:
            self._rates = (pose - self._pose) * np.float32(self.task.rate_hz)
        else:
            self._rates = np.column_stack((self.simulator.cart_velocity_m_s, self.simulator.tip_velocity_m_s()))
        self._pose = pose

    def _see(self, which: Mask | None = None) -> None:
        """Return the sensors' view; `which` limits it to robots whose episode has just begun."""
        if self.sensors is not None:
            seen = self.sensors.look(which)
            parts = (each[:, k] for each in (seen.positions_m, seen.velocities_m_s) for k in (0, -1))
            cart, tip, cart_rate, tip_rate = parts
            self._seen = np.column_stack((cart[:, 0], tip, cart_rate[:, 0], tip_rate)).astype(np.float32)

    def _observe(self) -> Array:
        seen, pressure = np.concatenate((self._pose, self._rates), axis=1), self.simulator.pressure_kpa
        if self.sensors is not None:
            seen, pressure = self._seen, self.simulator.pressure_reading_kpa
        observation = np.empty((self.robots, INPUTS), dtype=np.float32)
        observation[:, SEEN], observation[:, SENT], observation[:, PRESSURE] = seen, self._sent, pressure
        observation[:, len(Observation._fields) :] = self._target
        return observation


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

    def _begin(self, which: Mask, starts: Starts, targets_m: Array) -> None:
        super()._begin(which, starts, targets_m)
        self._place(which, calls.depths(self.task, self.rng, self.robots))

    def _place(self, which: Mask, depths_m: Array) -> None:
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
