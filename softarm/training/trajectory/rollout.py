"""Simulation of commands for many robots at once, from rest, on the batch simulator."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from softarm.schemas.model import Model
from softarm.schemas.robot import CONTROL_PERIOD_S, TRAINING_PHYSICS_RATE_HZ
from softarm.simulator.simulator import Simulator
from softarm.training.task.rail_guard import RailGuard

Array = NDArray[np.float32]


class Motion(NamedTuple):
    """Motion of robots at each control step, including the start."""

    state: Array  # [steps + 1, R, 2 + 2 n]: cart position and velocity, joint angles, joint rates
    tip_m: Array  # [steps + 1, R, 2]
    sent: Array  # [steps, R, 2]: the commands, after the guard if there is one

    def distance_m(self, targets_m: Array, rail_limit_m: float) -> Array:
        """Return the distances of the tips from targets [R, 2], infinite once a cart has left the rail, [steps + 1, R].

        Args:
            targets_m: y and z of each robot's target.
            rail_limit_m: Largest distance of a cart from the middle.
        """
        distance = np.hypot(*(self.tip_m - targets_m).transpose(2, 0, 1))
        kept = np.maximum.accumulate(np.abs(self.state[:, :, 0]), axis=0) <= rail_limit_m
        return np.where(kept, distance, np.inf)


class Rollouts:
    """Roll-outs on simulators cached by batch size, as creating one costs more than a step."""

    def __init__(self, model: Model | None = None, physics_rate_hz: float = TRAINING_PHYSICS_RATE_HZ) -> None:
        self.model = model or Model()
        self._physics_rate_hz = physics_rate_hz
        self._simulators: dict[int, Simulator] = {}

    def fly(self, commands: Array, cart_start_m: Array, guarded: bool = False) -> Motion:
        """Fly commands [steps, R, 2] (m/s, kPa) from straight, vented arms at rest, carts at [R].

        With `guarded`, velocities pass the daemon's braking clamp.
        """
        steps, robots = commands.shape[:2]
        if robots not in self._simulators:
            self._simulators[robots] = Simulator(self.model, robots=robots, physics_rate_hz=self._physics_rate_hz)
        simulator = self._simulators[robots]
        simulator.reset(cart_position_m=cart_start_m)
        guard = RailGuard(robots, CONTROL_PERIOD_S) if guarded else None
        n = simulator.links
        state = np.empty((steps + 1, robots, 2 + 2 * n), dtype=np.float32)
        tip = np.empty((steps + 1, robots, 2), dtype=np.float32)
        sent = commands.copy()
        for k in range(steps + 1):
            _look(simulator, state[k], tip[k])
            if k == steps:
                break
            if guard is not None:
                sent[k, :, 0] = guard.apply(sent[k, :, 0], state[k, :, 0], state[k, :, 1])
            simulator.step(sent[k, :, 0], sent[k, :, 1], CONTROL_PERIOD_S)
        return Motion(state, tip, sent)

    def settled_pose(self, pressure_kpa: float) -> Array:
        """Return the state [2 + 2 n] of an arm at rest at a pressure, with the cart in the middle."""
        simulator = Simulator(self.model, fixed_base=True)
        simulator.step(0.0, pressure_kpa, 10.0)
        state, tip = np.empty((1, 2 + 2 * simulator.links), dtype=np.float32), np.empty((1, 2), dtype=np.float32)
        _look(simulator, state, tip)
        state[0, 2 + simulator.links :] = 0.0
        pose: Array = state[0]
        return pose


def _look(simulator: Simulator, state: Array, tip: Array) -> None:
    n = simulator.links
    state[:, 0] = simulator.cart_position_m
    state[:, 1] = simulator.cart_velocity_m_s
    state[:, 2 : 2 + n] = simulator.joint_angles_rad
    rates = simulator.link_rates_rad_s
    state[:, 2 + n] = rates[:, 0]
    state[:, 3 + n :] = np.diff(rates, axis=1)
    tip[:] = simulator.tip_m()
