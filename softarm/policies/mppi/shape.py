"""Estimate of the joint angles from the tip alone, in pure numpy.

The links before the last have almost no mass. So between two camera frames the arm takes the shape of least elastic
energy for its tip position and the muscle's torque.
"""

import numpy as np
from numpy.typing import NDArray

from softarm.schemas.model import Arm

Array = NDArray[np.float64]

ITERATIONS = 12
SOFTNESS = 1e-4  # m^2 rad/(N m), regularises the equations of a straight arm, whose tip cannot move along it


def tip_from_cart_m(arm: Arm, joint_angles_rad: Array) -> Array:
    """Return the tip relative to the cart's hinge: y and height, [..., 2], from angles [..., n]."""
    absolute = np.cumsum(joint_angles_rad, axis=-1)
    lengths = np.array(arm.link_length_m)
    return np.stack((np.sin(absolute) @ lengths, -np.cos(absolute) @ lengths), axis=-1)


def tip_jacobian_m(arm: Arm, joint_angles_rad: Array) -> Array:
    """Return the Jacobian of the tip with respect to the joints, [2, n]."""
    absolute = np.cumsum(joint_angles_rad)
    lengths = np.array(arm.link_length_m)
    moves = np.stack((lengths * np.cos(absolute), lengths * np.sin(absolute)))
    return np.asarray(moves[:, ::-1].cumsum(axis=1)[:, ::-1])


def likely_joints(arm: Arm, tip_m: Array, tip_velocity_m_s: Array, pressure_kpa: float) -> tuple[Array, Array]:
    """Return joint angles (rad) and rates (rad/s), [n] each, of least elastic energy.

    Position and velocity of the tip are y and z, [2], relative to the hinge.
    """
    give = 1.0 / np.maximum(np.array(arm.stiffness_nm_rad), 1e-3)
    torque = np.array(arm.muscle_gain_nm_kpa) * pressure_kpa + np.array(arm.torque_offset_nm)
    free = -give * torque
    angles = 0.5 * free
    for _ in range(ITERATIONS):
        moves = tip_jacobian_m(arm, angles)
        back = give[:, None] * moves.T
        missing = tip_m - tip_from_cart_m(arm, angles) - moves @ (free - angles)
        change = free - angles + back @ np.linalg.solve(moves @ back + SOFTNESS * np.eye(2), missing)
        angles = angles + np.clip(change, -0.3, 0.3)
    moves = tip_jacobian_m(arm, angles)
    back = give[:, None] * moves.T
    rates = back @ np.linalg.solve(moves @ back + SOFTNESS * np.eye(2), tip_velocity_m_s)
    return angles, rates
