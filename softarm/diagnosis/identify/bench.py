"""Batch of arms with different parameters, driven by the measured pressure and cart motion.

Regulator and drive are left out.
"""

import numpy as np
from scipy.interpolate import CubicSpline

from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.identify.motion import Motion, directions, uniform
from softarm.schemas.model import Arm, Model
from softarm.schemas.robot import TRAINING_PHYSICS_RATE_HZ
from softarm.simulator.stage_simulator import StageSimulator

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
        self._simulator = StageSimulator(models, physics_rate_hz=TRAINING_PHYSICS_RATE_HZ)

    def replay(self, motion: Motion, starts: Array) -> Array:
        """Simulate a motion's inputs and return the signals at its stamps, [R, N, 3 n] as `Motion.signals`.

        Args:
            motion: measured motion.
            starts: absolute link angles, rad, and rates, rad/s, at the first stamp, [R, 2 n] or [2 n].
        """
        simulator, n = self._simulator, self._simulator.links
        starts = np.broadcast_to(starts, (simulator.robots, 2 * n))
        angles, rates = np.split(starts, 2, axis=1)
        simulator.reset(joint_angles_rad=np.diff(angles, axis=1, prepend=0.0), link_rates_rad_s=rates)
        t_s, cart = uniform(motion.t_s), CubicSpline(motion.t_s, motion.cart_m)
        position, speed = cart(t_s) - motion.cart_m[0], cart(t_s, 1)
        pressure = np.interp(t_s, motion.t_s, motion.pressure_kpa)
        position, speed, pressure = (
            np.repeat(each[:, None], simulator.robots, 1) for each in (position, speed, pressure)
        )
        ends = simulator.fly_arm(position, speed, pressure, t_s[1] - t_s[0]).transpose(2, 0, 1).astype(np.float64)
        ends[..., :n] -= position.T[..., None]
        ends[..., n:] -= simulator.model.arm.base_height_m
        path = np.concatenate((ends, directions(ends)), axis=2)
        return np.asarray(CubicSpline(t_s, path, axis=1)(motion.t_s))
