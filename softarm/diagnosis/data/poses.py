"""Measured poses of a MuJoCo model's floating bodies and ball joints: columns of positions and quaternions."""

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from softarm.diagnosis.data import checks
from softarm.diagnosis.data.stage_rules import QUATERNION
from softarm.diagnosis.data.trials import Array, Series, TrialError

# Position, speed and acceleration of each column, [T] each.
Motion = Mapping[str, Sequence[Array]]


@dataclass(frozen=True, slots=True)
class PoseJoint:
    """Free or ball joint of a model, whose pose is measured; its columns are NAME_x to NAME_qz."""

    name: str
    floats: bool  # free joint; else a ball joint
    position: int  # first index in qpos
    dof: int  # first index in qvel

    @property
    def place(self) -> tuple[str, ...]:
        """Return the columns of the position, m, in the model's frame."""
        return tuple(f"{self.name}_{axis}" for axis in "xyz") if self.floats else ()

    @property
    def turn(self) -> tuple[str, ...]:
        """Return the columns of the orientation's quaternion."""
        return tuple(f"{self.name}{part}" for part in QUATERNION)

    @property
    def columns(self) -> tuple[str, ...]:
        """Return all columns of the pose."""
        return self.place + self.turn

    def lacking(self, columns: Container[str]) -> tuple[str, ...]:
        """Return the columns that are missing."""
        return tuple(name for name in self.columns if name not in columns)

    def continuous(self, series: Series, where: Path) -> Series:
        """Return columns whose quaternion does not change its sign between two rows.

        Raises:
            TrialError: the orientation lacks a column, or its quaternions have no length of one.
        """
        given = [name for name in self.turn if name in series.columns]
        if not given:
            return series
        if missing := [name for name in self.turn if name not in series.columns]:
            raise TrialError(
                f"{where}: the orientation of {self.name} lacks {', '.join(missing)}; name all four columns, or none"
            )
        quaternion = checks.unit_quaternions(series, self.turn, str(where))
        signs = np.sign(np.sum(quaternion[1:] * quaternion[:-1], axis=1))
        signs = np.cumprod(np.concatenate(([1.0], np.where(signs < 0, -1.0, 1.0))))
        turned = {name: column * signs for name, column in zip(self.turn, quaternion.T, strict=True)}
        return Series(series.t_s, {**series.columns, **turned})

    def write(self, motion: Motion, qpos: Array, qvel: Array, qacc: Array) -> None:
        """Write the measured pose into a motion of the model, [T, nq], [T, nv] and [T, nv].

        Its linear part is in the world's frame and its angular part in the body's, as in MuJoCo.
        """
        for i, name in enumerate(self.place):
            if name in motion:
                qpos[:, self.position + i], qvel[:, self.dof + i], qacc[:, self.dof + i] = motion[name]
        if self.turn[0] not in motion:
            return
        values, rates, curves = (np.stack([motion[name][d] for name in self.turn], axis=1) for d in range(3))
        lengths = np.linalg.norm(values, axis=1, keepdims=True)
        at, first = self.position + 3 * self.floats, self.dof + 3 * self.floats
        turn = values / lengths
        qpos[:, at : at + 4] = turn
        qvel[:, first : first + 3] = 2 * _within_body(turn, rates / lengths)
        qacc[:, first : first + 3] = 2 * _within_body(turn, curves / lengths)


def pose_joints(mujoco: Any, model: Any) -> dict[int, PoseJoint]:
    """Return the free and ball joints of a model by their numbers; floating bodies seldom name their joint."""
    found, free, ball = dict[int, PoseJoint](), int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)
    for number in np.flatnonzero(np.isin(model.jnt_type, (free, ball))):
        body = model.body(int(model.jnt_bodyid[number])).name or f"body{model.jnt_bodyid[number]}"
        name, floats = model.joint(int(number)).name or body, model.jnt_type[number] == free
        at = int(model.jnt_qposadr[number]), int(model.jnt_dofadr[number])
        found[int(number)] = PoseJoint(str(name), bool(floats), *at)
    return found


def _within_body(turn: Array, change: Array) -> Array:
    """Return the vector part of the conjugate of a quaternion times its change, [T, 3]."""
    w, v = turn[:, :1], turn[:, 1:]
    return np.asarray(w * change[:, 1:] - change[:, :1] * v - np.cross(v, change[:, 1:]))
