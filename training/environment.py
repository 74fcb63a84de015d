"""Many robots at one task, side by side: observations in, rewards out, episodes restarted as they end."""

import json
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from schemas.model import Model
from schemas.policy import ACTION, OBSERVATION, REACH_GOAL
from simulator.simulator import Simulator
from training.rail_guard import RailGuard
from training.tasks import ReachTask, Starts

Array = NDArray[np.float32]
Mask = NDArray[np.bool_]

INPUTS = len(OBSERVATION) + len(REACH_GOAL)
ACTIONS = len(ACTION)
_LOW = np.array([signal.low for signal in ACTION], dtype=np.float32)
_HIGH = np.array([signal.high for signal in ACTION], dtype=np.float32)
_ARRAYS = ("_target", "_elapsed", "_sent", "_pose", "_rates")  # of an environment's own


class Step(NamedTuple):
    """What a step gave; one entry a robot."""

    observation: Array  # [R, 10], of the new episode where one ended
    reward: Array  # [R], scaled
    terminated: Mask  # reached, or off the rail: nothing comes after
    truncated: Mask  # out of time: the value of `final_observation` stands for what would have come
    success: Mask
    final_observation: Array  # [R, 10], before any restart


def to_physical(action: Array) -> Array:
    """Map actions in -1..1, float32 [..., 2], to cart velocity (m/s) and pressure (kPa)."""
    return _LOW + (np.clip(action, -1.0, 1.0) + 1.0) * (0.5 * (_HIGH - _LOW))


class Environment:
    """A batch of robots at one task. Arrays are copies; everything random comes from one seeded generator."""

    def __init__(
        self,
        task: ReachTask,
        robots: int,
        seed: int,
        model: Model | None = None,
        physics_rate_hz: float = 240.0,
    ) -> None:
        self.task = task
        self.robots = robots
        self.rng = np.random.default_rng(seed)
        self.simulator = Simulator(model, robots=robots, physics_rate_hz=physics_rate_hz)
        self._differenced = "observation.finite_difference" in self.simulator.model.effects
        self._guard = RailGuard(robots, 1.0 / task.rate_hz) if task.rail_guard else None
        self._target = np.zeros((robots, 2), dtype=np.float32)
        self._elapsed = np.zeros(robots, dtype=np.int64)
        self._sent = np.zeros(robots, dtype=np.float32)
        self._pose = np.zeros((robots, 3), dtype=np.float32)  # cart y, tip y, tip z
        self._rates = np.zeros((robots, 3), dtype=np.float32)

    def reset(self, starts: Starts | None = None, targets_m: Array | None = None) -> Array:
        """Begin an episode everywhere; returns the observation [R, 10]. What is not given is drawn from the task."""
        everyone = np.ones(self.robots, dtype=np.bool_)
        links = self.simulator.links
        self._begin(
            everyone,
            starts or self.task.sample_starts(self.rng, self.robots, links),
            self.task.sample_targets(self.rng, self.robots) if targets_m is None else targets_m,
        )
        return self._observe()

    def stagger(self) -> None:
        """Spread the episodes' ages evenly, so that a batch does not run out of time all at once."""
        self._elapsed[:] = self.rng.integers(0, self.task.episode_steps, self.robots)

    def step(self, action: Array) -> Step:
        """Hold an action, float32 [R, 2] in -1..1, for a control step; robots whose episode ends begin a new one."""
        noise = self.task.action_noise * self.rng.standard_normal(action.shape, dtype=np.float32)
        velocity, pressure = to_physical(action + noise).T
        simulator = self.simulator
        if self._guard is not None:
            velocity = self._guard.apply(velocity, simulator.cart_position_m, simulator.cart_velocity_m_s)
        self._sent = velocity
        simulator.step(velocity, pressure, 1.0 / self.task.rate_hz)
        self._look()
        self._elapsed += 1

        tip = self._pose[:, 1:]
        success = self.task.succeeded(tip, self._target)
        # A state that is no number ends its episode as a crash does, so that it cannot spread.
        off_rail = ~(np.abs(self._pose[:, 0]) <= self.task.rail_limit_m)
        success &= ~off_rail
        terminated = success | off_rail
        truncated = ~terminated & (self._elapsed >= self.task.episode_steps)
        speed = np.nan_to_num(np.linalg.norm(self._rates[:, 1:], axis=1))
        reward = self.task.reward(success, off_rail, speed)
        final = np.nan_to_num(self._observe())
        self._restart(terminated | truncated)
        return Step(self._observe(), reward, terminated, truncated, success, final)

    def snapshot(self) -> dict[str, Any]:
        """Where every robot is and which random numbers come next, as tensors and plain values."""
        arrays = {name: torch.from_numpy(getattr(self, name).copy()) for name in _ARRAYS}
        guard = None if self._guard is None else torch.from_numpy(self._guard.sent_m_s.copy())
        simulator = torch.from_numpy(self.simulator.snapshot())
        return {**arrays, "guard": guard, "simulator": simulator, "rng": json.dumps(self.rng.bit_generator.state)}

    def restore(self, content: dict[str, Any]) -> None:
        """Go back to a snapshot of an environment made with the same arguments."""
        for name in _ARRAYS:
            setattr(self, name, content[name].numpy().copy())
        if self._guard is not None:
            self._guard.sent_m_s = content["guard"].numpy().copy()
        self.simulator.restore(content["simulator"].numpy())
        self.rng.bit_generator.state = json.loads(content["rng"])

    def _restart(self, over: Mask) -> None:
        if over.any():
            # Drawn for everybody: what one robot gets does not depend on how many others restart with it.
            starts = self.task.sample_starts(self.rng, self.robots, self.simulator.links)
            self._begin(over, starts, self.task.sample_targets(self.rng, self.robots))

    def _begin(self, which: Mask, starts: Starts, targets_m: Array) -> None:
        self.simulator.reset(robots=which, **starts._asdict())
        if self._guard is not None:
            self._guard.reset(which)
        self._target[which] = targets_m[which]
        self._elapsed[which] = 0
        self._sent = np.where(which, np.float32(0.0), self._sent)
        pose = self._measure()
        self._pose[which] = pose[which]
        self._rates[which] = 0.0

    def _measure(self) -> Array:
        return np.column_stack((self.simulator.cart_position_m, self.simulator.tip_m()))

    def _look(self) -> None:
        pose = self._measure()
        if self._differenced:
            self._rates = (pose - self._pose) * np.float32(self.task.rate_hz)
        else:
            self._rates = np.column_stack((self.simulator.cart_velocity_m_s, self.simulator.tip_velocity_m_s()))
        self._pose = pose

    def _observe(self) -> Array:
        cart, tip = self._pose[:, :1], self._pose[:, 1:]
        return np.concatenate(
            (
                cart,
                self._rates[:, :1],
                tip,
                self._rates[:, 1:],
                self._sent[:, None],
                self.simulator.pressure_kpa[:, None],
                self._target,
            ),
            axis=1,
        )
