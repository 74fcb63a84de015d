"""Optimisation problem of [P] SM-H: costs, constraints and the parameters of a plan.

    minimise  sum_k |x^k - x_nominal|^2_Q + sum_k |u^k|^2_R    subject to
    the robot's dynamics, limits on commands, cart position and cart velocity, and the tip on the target at step N

State x: cart position and velocity, joint angles and their rates. The seed's inputs are the cart's force and the
pressure, without actuators. Here the inputs are the robot's, commands of velocity and pressure; lag, ramp and delay are
part of the dynamics. The change of the velocity command over a control step gives the force: F = m dv/dt.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softarm.schemas.config import RailLimits
from softarm.schemas.robot import CONTROL_RATE_HZ

Array = NDArray[np.float32]
RAIL_SPARE_M = 0.005  # distance of plans from the position where the safety filter begins to brake
KNOT_STEPS = 3  # control steps between knots; commands are linear between them


@dataclass(frozen=True)
class PlanningProblem:
    """Weights and limits. Defaults: [P] SM-H where it gives a number."""

    steps_max: int = 98  # control steps until the tip is on target; the rest of 100 are for the extended horizon
    rate_hz: float = float(CONTROL_RATE_HZ)
    # diag(Q^k), diag(Q^N), of positions (m, rad) and of rates; R is 1 of both inputs.
    position_weight: float = 10.0
    rate_weight: float = 1.0
    final_position_weight: float = 100.0
    final_rate_weight: float = 10.0
    force_weight: float = 1.0  # per N^2
    pressure_weight: float = 1.0  # per (10 kPa)^2, so that both inputs count alike
    nominal_pressure_kpa: float = 10.0  # the arm at rest under it, bent to the left, is the nominal pose
    # Inside the actuators' range, so that the tracking controller has room ("conservative constraints").
    velocity_max_m_s: float = 0.95
    pressure_min_kpa: float = 0.0
    pressure_max_kpa: float = 19.5
    acceleration_max_m_s2: float = 6.0  # of the velocity command: the drive's own ramp
    moved_mass_kg: float = 0.52  # cart and arm
    # The cart must be able to brake before this, by the law of the safety filter (RailLimits).
    rail_max_m: float = RailLimits().position_max_m - RailLimits().margin_m - RAIL_SPARE_M
    braking_m_s2: float = RailLimits().braking_m_s2

    @property
    def knots(self) -> int:
        """Number of knots of each command for the longest plan."""
        return self.knots_for(self.steps_max)

    @staticmethod
    def knots_for(steps: int) -> int:
        """Return the number of knots for commands of `steps` control steps."""
        return -(-(steps - 1) // KNOT_STEPS) + 1


def interpolation(steps: int) -> Array:
    """Return the matrix [steps, knots] from knots to the commands of each control step."""
    knots = PlanningProblem.knots_for(steps)
    k = np.arange(steps) / KNOT_STEPS
    return np.maximum(0.0, 1.0 - np.abs(k[:, None] - np.arange(knots))).astype(np.float32)
