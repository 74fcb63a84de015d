"""Batch of arms with different parameters, driven by the measured pressure and cart motion.

Regulator and drive are left out.
"""

from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline

from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.identify.motion import Motion
from softarm.schemas.model import Arm, Model
from softarm.schemas.robot import TRAINING_PHYSICS_RATE_HZ
from softarm.simulator.simulator import Simulator

PARAMETERS = ("stiffness_nm_rad", "damping_nm_s_rad", "muscle_gain_nm_kpa", "torque_offset_nm")


def to_columns(arm: Arm) -> Array:
    """Return an arm's fitted parameters as one column, [4 n] in PARAMETERS order."""
    return np.concatenate([np.asarray(getattr(arm, name), dtype=float) for name in PARAMETERS])


def from_column(arm: Arm, column: Array) -> Arm:
    """Return the arm with the parameters of a column."""
    parts = np.split(column, len(PARAMETERS))
    return arm.model_copy(
        update={name: tuple(float(v) for v in part) for name, part in zip(PARAMETERS, parts, strict=True)}
    )


def names(links: int) -> tuple[str, ...]:
    """Return the name of every entry of a column."""
    return tuple(f"{name}[{i}]" for name in PARAMETERS for i in range(1, links + 1))


class Bench:
    """Robots with different arms under one measured input."""

    def __init__(self, arm: Arm, columns: Array) -> None:
        """Create one robot per row of `columns`, [R, 4 n]."""
        models = [Model(arm=from_column(arm, column), effects={}) for column in columns]
        self._simulator = Simulator(models, physics_rate_hz=TRAINING_PHYSICS_RATE_HZ)
        self._lengths = np.array(arm.link_length_m)

    def replay(self, motion: Motion, starts: Array) -> Array:
        """Simulate a motion's inputs and return the signals at its stamps, [R, N, 3 n] as `Motion.signals`.

        Args:
            motion: measured motion.
            starts: absolute link angles, rad, and rates, rad/s, at the first stamp, [R, 2 n] or [2 n].
        """
        simulator = self._simulator
        starts = np.broadcast_to(starts, (simulator.robots, 2 * simulator.links))
        angles, rates = np.split(starts, 2, axis=1)
        simulator.reset(joint_angles_rad=np.diff(angles, axis=1, prepend=0.0), link_rates_rad_s=rates)
        speeds = CubicSpline(motion.t_s, motion.cart_m).derivative()(motion.t_s)
        carts = np.column_stack((motion.cart_m - motion.cart_m[0], speeds, motion.pressure_kpa)).tolist()
        # Equal to the last bit, so that the simulator reuses its preparation.
        lengths = np.round(np.diff(motion.t_s), 8).tolist()
        seen = [simulator.link_angles_rad]
        for (before, (cart, speed, pressure)), length in zip(pairwise(carts), lengths, strict=True):
            simulator.step_arm(cart, speed, pressure, length, start=before)
            seen.append(simulator.link_angles_rad)
        angles = np.stack(seen, axis=1)
        y = np.cumsum(self._lengths * np.sin(angles), axis=2)
        z = -np.cumsum(self._lengths * np.cos(angles), axis=2)
        return np.concatenate((y, z, angles), axis=2)
