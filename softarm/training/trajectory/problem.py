"""Optimisation problem of [P] SM-H: costs, constraints and the parameters of a plan.

    minimise  sum_k |x^k - x_nominal|^2_Q + sum_k |u^k|^2_R    subject to
    the robot's dynamics, limits on commands, cart position and cart velocity, and the tip on the target at step N

State x: cart position and velocity, joint angles and their rates. The seed's inputs are the cart's force and the
pressure, without actuators. Here the inputs are the robot's, commands of velocity and pressure; lag, ramp and delay are
part of the dynamics. The change of the velocity command over a control step gives the force: F = m dv/dt.
"""

import numpy as np
from numpy.typing import NDArray

from softarm.schemas.config import RailLimits

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
