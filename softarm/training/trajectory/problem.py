"""Optimisation problem of [P] SM-H: costs, constraints and the parameters of a plan.

    minimise  sum_k |x^k - x_nominal|^2_Q + sum_k |u^k|^2_R    subject to
    the robot's dynamics, limits on commands, cart position and cart velocity, and the tip on the target at step N

State x: cart position and velocity, joint angles and their rates. The seed's inputs are the cart's force and the
pressure, without actuators. Here the inputs are the robot's, commands of velocity and pressure; lag, ramp and delay are
part of the dynamics. The change of the velocity command over a control step gives the force: F = m dv/dt.

Roll-outs simulate commands for many robots at once, from rest, on the batch simulator.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from softarm.schemas.config import RailLimits
from softarm.schemas.model import Model
from softarm.schemas.robot import CONTROL_PERIOD_S, TRAINING_PHYSICS_RATE_HZ
from softarm.simulator.simulator import Simulator
from softarm.training.task.rail_guard import RailGuard

Array = NDArray[np.float32]
KNOT_STEPS = 3  # control steps between knots; commands are linear between them
STEPS_MAX = 98  # control steps until the tip is on target; the rest of 100 are for the extended horizon
# [P] SM-H where it gives a number: diag(Q^k) and diag(Q^N) of positions (m, rad) and of rates; R is 1 of both inputs.
POSITION_WEIGHT, RATE_WEIGHT = 10.0, 1.0
FINAL_POSITION_WEIGHT, FINAL_RATE_WEIGHT = 100.0, 10.0
FORCE_WEIGHT = 1.0  # per N^2
PRESSURE_WEIGHT = 1.0  # per (10 kPa)^2, so that both inputs count alike
NOMINAL_PRESSURE_KPA = 10.0  # the arm at rest under it, bent to the left, is the nominal pose
# Inside the actuators' range, so that the tracking controller has room ("conservative constraints").
VELOCITY_MAX_M_S = 0.95
PRESSURE_MIN_KPA, PRESSURE_MAX_KPA = 0.0, 19.5
ACCELERATION_MAX_M_S2 = 6.0  # of the velocity command: the drive's own ramp
MOVED_MASS_KG = 0.52  # cart and arm
RAIL_SPARE_M = 0.005  # distance of plans from the position where the safety filter begins to brake
# The cart must be able to brake before this, by the law of the safety filter (RailLimits).
RAIL_MAX_M = RailLimits().position_max_m - RailLimits().margin_m - RAIL_SPARE_M
BRAKING_M_S2 = RailLimits().braking_m_s2


def stopping_m(position_m: Array, velocity_m_s: Array) -> Array:
    """Return where a cart stops that brakes now, m."""
    place: Array = position_m + velocity_m_s * np.abs(velocity_m_s) / np.float32(2 * BRAKING_M_S2)
    return place


def interpolation(steps: int) -> Array:
    """Return the matrix [steps, knots] from knots to the commands of each control step."""
    knots = -(-(steps - 1) // KNOT_STEPS) + 1
    k = np.arange(steps) / KNOT_STEPS
    return np.maximum(0.0, 1.0 - np.abs(k[:, None] - np.arange(knots))).astype(np.float32)


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
    """Roll-outs of a model at a rate of physics; `limits` are those of the braking clamp."""

    def __init__(
        self,
        model: Model | None = None,
        physics_rate_hz: float = TRAINING_PHYSICS_RATE_HZ,
        limits: RailLimits | None = None,
    ) -> None:
        self.model = model or Model()
        self._physics_rate_hz, self._limits = physics_rate_hz, limits

    def fly(self, commands: Array, cart_start_m: Array, guarded: bool = False) -> Motion:
        """Fly commands [steps, R, 2] (m/s, kPa) from straight, vented arms at rest, carts at [R].

        With `guarded`, velocities pass the daemon's braking clamp.
        """
        steps, robots = commands.shape[:2]
        simulator = Simulator(self.model, robots=robots, physics_rate_hz=self._physics_rate_hz)
        simulator.reset(cart_position_m=cart_start_m)
        guard = RailGuard(robots, CONTROL_PERIOD_S, self._limits) if guarded else None
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
        _against_each_other(state, n)
        return Motion(state, tip, sent)

    def settled_pose(self, pressure_kpa: float) -> Array:
        """Return the state [2 + 2 n] of an arm at rest at a pressure, with the cart in the middle."""
        simulator = Simulator(self.model, fixed_base=True)
        simulator.step(0.0, pressure_kpa, 10.0)
        state, tip = np.empty((1, 2 + 2 * simulator.links), dtype=np.float32), np.empty((1, 2), dtype=np.float32)
        _look(simulator, state, tip)
        _against_each_other(state, simulator.links)
        state[0, 2 + simulator.links :] = 0.0
        pose: Array = state[0]
        return pose


def _look(simulator: Simulator, state: Array, tip: Array) -> None:
    """Read a state with absolute angles and rates of the links, and the tip."""
    n = simulator.links
    state[:, 0] = simulator.cart_position_m
    state[:, 1] = simulator.cart_velocity_m_s
    state[:, 2 : 2 + n] = simulator.link_angles_rad
    state[:, 2 + n :] = simulator.link_rates_rad_s
    tip[:] = simulator.tip_m()


def _against_each_other(state: Array, links: int) -> None:
    """Turn absolute angles and rates of links into those of joints, in place."""
    for first in (2, 2 + links):
        for link in range(first + links - 1, first, -1):
            state[..., link] -= state[..., link - 1]
