"""Batch environment in tensors on one device, so that training needs no copy through the CPU's memory.

The built-in reach task of `environment.Environment`, with the same dynamics, observation, reward and rail guard; random
numbers differ. No method waits for the device, and every state keeps its memory, so CUDA graphs can replay steps.
"""

from typing import Any

import numpy as np
import torch
from torch import Tensor

from softarm.policies.base import HIGH, LOW
from softarm.schemas.model import Model
from softarm.schemas.policy import Observation
from softarm.schemas.robot import TRAINING_PHYSICS_RATE_HZ
from softarm.simulator.cuda.simulator import TensorSimulator
from softarm.training.task.environment import (
    ACTIONS,
    DIFFERENCES,
    PRESSURE,
    SEEN,
    SENT,
    Environment,
    Randomisation,
    Step,
    distorts,
    environment_of,
)
from softarm.training.task.reach import Moment, Range, ReachTask, Starts
from softarm.training.task.tensor_guard import TensorGuard
from softarm.training.task.tensor_sensors import TensorSensors

# Sets of parameters that robots take in turn when a randomisation draws for each episode.
VARIANTS = 4096


class TensorEnvironment:
    """Batch of robots at the reach task. One seeded generator of the device draws all random numbers."""

    restarts = True  # False: robots whose episode has ended stay as they are until `reset`
    _tensors = ("_target", "_elapsed", "_sent", "_pose", "_rates")  # of a snapshot

    def __init__(
        self,
        task: ReachTask,
        robots: int,
        seed: int,
        model: Model | None = None,
        physics_rate_hz: float = TRAINING_PHYSICS_RATE_HZ,
        randomisation: Randomisation | None = None,
        device: torch.device | str = "cuda",
    ) -> None:
        """Create robots of one model (default: the seed's) that differ by the randomisation.

        Raises ValueError for a task or effects that need the CPU.
        """
        randomisation, model = randomisation or Randomisation(), model or Model()
        _refuse(task, model, randomisation)
        self.task, self.robots, self.device = task, robots, torch.device(device)
        self.inputs = len(Observation._fields) + len(task.goal)
        self.generator = torch.Generator(self.device).manual_seed(seed)
        self._redrawn = bool(randomisation.ranges) and randomisation.each_episode
        drawn = randomisation.draw(np.random.default_rng((seed, DIFFERENCES)), VARIANTS if self._redrawn else robots)
        self.simulator = TensorSimulator(
            model, robots, physics_rate_hz, overrides=drawn, step_s=1.0 / task.rate_hz, device=self.device
        )
        self._differenced = "observation.finite_difference" in model.effects
        seen_through = any(map(distorts, randomisation.effects_with(model)))
        self.sensors = (
            TensorSensors(self.simulator, 1.0 / task.rate_hz, self._differenced, self.generator)
            if seen_through
            else None
        )
        limits = task.rail_limits
        self._guard = TensorGuard(robots, 1.0 / task.rate_hz, limits, self.device) if task.rail_guard else None
        self._low, self._half = self._there(LOW), self._there(0.5 * (HIGH - LOW))
        self._target, self._pose, self._rates = (torch.zeros((robots, k), device=self.device) for k in (2, 3, 3))
        self._sent = torch.zeros(robots, device=self.device)
        self._elapsed = torch.zeros(robots, dtype=torch.int64, device=self.device)
        self._everyone = torch.ones(robots, dtype=torch.bool, device=self.device)

    def reset(self, starts: Starts | None = None, targets_m: Any = None) -> Tensor:
        """Begin an episode for every robot and return the observation [R, 10]; missing values are drawn."""
        given = self._starts() if starts is None else Starts(*map(self._there, starts))
        self._begin(self._everyone, given, self._targets() if targets_m is None else self._there(targets_m))
        return self._observe()

    def stagger(self) -> None:
        """Spread the ages of the episodes evenly, so that they do not all end at once."""
        self._elapsed.random_(0, self.task.episode_steps, generator=self.generator)

    def step(self, action: Any) -> Step:
        """Hold an action [R, 2] in -1..1 for a control step, and return tensors; ended episodes begin again."""
        task, simulator = self.task, self.simulator
        noisy = self._there(action) + task.action_noise * self._normal((self.robots, ACTIONS))
        velocity, pressure = (self._low + (noisy.clamp(-1.0, 1.0) + 1.0) * self._half).unbind(1)
        if self._guard is not None:
            velocity = self._guard.apply(velocity, simulator.cart_position_m, simulator.cart_velocity_m_s)
        if not task.muscle:
            pressure = torch.zeros_like(pressure)
        self._sent.copy_(velocity)
        simulator.step(velocity, pressure)
        self._look()
        if self.sensors is not None:
            self.sensors.look()
        self._elapsed += 1

        cart, tip = self._pose[:, 0], self._pose[:, 1:]
        success = torch.linalg.vector_norm(tip - self._target, dim=1) < task.success_radius_m
        # NaN ends the episode like a crash, so that it cannot spread.
        off_rail = ~(cart.abs() <= task.rail_limit_m)
        success &= ~off_rail
        terminated = success | off_rail
        truncated = ~terminated & (self._elapsed >= task.episode_steps)
        speed = torch.linalg.vector_norm(self._rates[:, 1:], dim=1).nan_to_num()
        final, final_tip = self._observe().nan_to_num(), tip.nan_to_num()
        moment: tuple[Any, ...] = (final_tip, speed, self._target, cart.nan_to_num(), success, off_rail)
        reward = task.score(Moment(*moment))
        if self.restarts:
            self._begin(terminated | truncated, self._starts(), self._targets())
        step: tuple[Any, ...] = (self._observe(), reward, terminated, truncated, success, final, final_tip)
        return Step(*step)

    def snapshot(self) -> dict[str, Any]:
        """Return the state of all robots and of the generator, as tensors of the CPU."""
        tensors = {name: getattr(self, name).cpu().clone() for name in self._tensors}
        guard = None if self._guard is None else self._guard.sent_m_s.cpu().clone()
        sensors = None if self.sensors is None else self.sensors.snapshot()
        rng = self.generator.get_state()
        return {**tensors, "guard": guard, "simulator": self.simulator.snapshot(), "sensors": sensors, "rng": rng}

    def restore(self, content: dict[str, Any]) -> None:
        """Restore a snapshot of an environment with the same arguments."""
        for name in self._tensors:
            getattr(self, name).copy_(content[name])
        if self._guard is not None:
            self._guard.sent_m_s.copy_(content["guard"])
        self.simulator.restore(content["simulator"])
        if self.sensors is not None:
            self.sensors.restore(content["sensors"])
        self.generator.set_state(content["rng"])

    def _begin(self, which: Tensor, starts: Any, targets_m: Tensor) -> None:
        """Begin an episode of some robots, bool [R]; the other arguments have entries for all."""
        variant = None
        if self._redrawn:
            variant = torch.randint(VARIANTS, (self.robots,), generator=self.generator, device=self.device)
        cart, angles, pressure = starts
        self.simulator.reset(which, cart, angles, pressure, variant)
        if self._guard is not None:
            self._guard.reset(which)
        column = which.unsqueeze(1)
        self._target.copy_(torch.where(column, targets_m, self._target))
        self._pose.copy_(torch.where(column, self._measured(), self._pose))
        self._rates.masked_fill_(column, 0.0)
        self._sent.masked_fill_(which, 0.0)
        self._elapsed.masked_fill_(which, 0)
        if self.sensors is not None:
            self.sensors.begin(which, variant)

    def _starts(self) -> Any:
        """Draw start states as `ReachTask.sample_starts` does."""
        task, robots = self.task, self.robots
        cart = self._uniform(task.cart_start_m, robots)
        turn = float(np.deg2rad(task.joint_start_deg))
        angles = self._uniform((-turn, turn), robots, self.simulator.links)
        pressure = self._uniform(task.pressure_start_kpa, robots)
        vented = self._uniform((0.0, 1.0), robots) < (task.vented_starts if task.muscle else 1.0)
        return cart, angles, pressure.masked_fill(vented, 0.0)

    def _targets(self) -> Tensor:
        return torch.stack(
            [self._uniform(each, self.robots) for each in (self.task.target_y_m, self.task.target_z_m)], 1
        )

    def _measured(self) -> Tensor:
        return torch.cat((self.simulator.cart_position_m.unsqueeze(1), self.simulator.tip_m()), dim=1)

    def _look(self) -> None:
        pose, simulator = self._measured(), self.simulator
        if self._differenced:
            self._rates.copy_((pose - self._pose) * self.task.rate_hz)
        else:
            self._rates.copy_(
                torch.cat((simulator.cart_velocity_m_s.unsqueeze(1), simulator.tip_velocity_m_s()), dim=1)
            )
        self._pose.copy_(pose)

    def _observe(self) -> Tensor:
        seen, pressure = torch.cat((self._pose, self._rates), dim=1), self.simulator.pressure_kpa
        if self.sensors is not None:
            parts = (self.sensors.positions_m.flatten(1), self.sensors.velocities_m_s.flatten(1))
            seen = torch.cat([part for each in parts for part in (each[:, :1], each[:, 2:])], dim=1)
            pressure = self.sensors.pressure_kpa
        columns = dict(zip(SEEN, seen.unbind(1), strict=True)) | {SENT: self._sent, PRESSURE: pressure}
        return torch.stack([*(columns[k] for k in range(len(columns))), *self._target.unbind(1)], dim=1)

    def _there(self, values: Any) -> Tensor:
        return torch.as_tensor(values, dtype=torch.float32, device=self.device)

    def _uniform(self, ends: Range, *shape: int) -> Tensor:
        return torch.empty(shape, device=self.device).uniform_(*ends, generator=self.generator)

    def _normal(self, shape: tuple[int, ...]) -> Tensor:
        return torch.randn(shape, generator=self.generator, device=self.device)


def environment_on(
    device: torch.device,
    task: ReachTask,
    robots: int,
    seed: int,
    model: Model | None = None,
    physics_rate_hz: float = TRAINING_PHYSICS_RATE_HZ,
    randomisation: Randomisation | None = None,
) -> Environment | TensorEnvironment:
    """Create the environment of a task on a device; the CPU's works with arrays. Raises ValueError."""
    if device.type == "cpu":
        return environment_of(task, robots, seed, model, physics_rate_hz, randomisation)
    return TensorEnvironment(task, robots, seed, model, physics_rate_hz, randomisation, device)


def array_of(values: Any) -> Any:
    """Return a tensor of any device as an array; an array stays as it is."""
    return torch.as_tensor(values).cpu().numpy()


def _refuse(task: ReachTask, model: Model, randomisation: Randomisation) -> None:
    """Raise ValueError for what the CPU alone simulates."""
    if type(task) is not ReachTask:
        kind = type(task).__name__
        raise ValueError(f"task '{task.name}' is a {kind}; a graphics card runs ReachTask alone: choose device cpu")
    clocks = sorted(randomisation.effects_with(model) & {"clock.jitter", "clock.missed_ticks"})
    if clocks:
        raise ValueError(
            f"a graphics card does not run the effects {', '.join(clocks)}: leave them out, or choose device cpu"
        )
