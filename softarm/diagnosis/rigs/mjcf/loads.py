"""Forces that bodies need along a measured motion, as linear functions of masses, of a payload and of gravity.

The force of one point of a body, projected on the speed of a joint, is a polynomial of second degree in the place of
the point. So that of the body is linear in its mass and its first and second moments (Atkeson, An and Hollerbach 1986,
Estimation of Inertial Parameters of Manipulator Loads and Links).
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from softarm.diagnosis.data.mjcf import carriers
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.mjcf.closure import State

# Samples that are computed together, which bounds the memory.
TOGETHER = 2000


class BodyForces(NamedTuple):
    """Projected forces of B bodies in S states of a mechanism at T samples."""

    own: Array  # [B, S, T]
    point: Array  # [10, S, T] of a point of the last link, per kg, for each of `powers`
    gravity: Array  # [3, S, T] of all bodies, per m/s^2 of each axis of gravity


class _Kinematics(NamedTuple):
    """Kinematics of one state: MuJoCo's motion axes about the centre of mass of each tree, and all bodies' frames."""

    axes: Array  # [T, nv, 6]
    rates: Array  # of the axes, [T, nv, 6]
    origin: Array  # [T, nbody, 3]
    centre: Array  # of mass of the body's tree, [T, nbody, 3]
    frame: Array  # [T, nbody, 3, 3]


class Bodies:
    """Bodies of a model that a joint moves."""

    def __init__(self, mujoco: Any, model: Any, bodies: Sequence[int], last: int) -> None:
        """Find the degrees of freedom that move each body; last: body that carries a payload."""
        self._mujoco, self._model, self._bodies = mujoco, model, list(bodies)
        self._last = self._bodies.index(last)
        self._moves = np.array([np.isin(model.dof_jntid, [*carriers(model, body)]) for body in bodies], dtype=float)
        weightless = bool(model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY))
        self._felt = (1.0 - model.body_gravcomp[self._bodies]) * (not weightless)  # share of gravity
        self._moments = np.array([self._moments_of(body) for body in bodies])

    def forces(self, states: Sequence[State]) -> BodyForces:
        """Return the forces in some states of the model; states that share arrays are computed faster."""
        starts = range(0, len(states[0].position), TOGETHER)
        parts = [self._part(states, slice(k, k + TOGETHER)) for k in starts]
        return BodyForces(*(np.concatenate(each, axis=-1) for each in zip(*parts, strict=True)))

    def _part(self, states: Sequence[State], samples: slice) -> BodyForces:
        each = zip(states, self._kinematics(states, samples), strict=True)
        found = [self._forces(State._make(of[samples] for of in state), seen) for state, seen in each]
        own, point, gravity = zip(*found, strict=True)
        return BodyForces(np.stack(own, axis=1), np.stack(point, axis=1), np.stack(gravity, axis=1))

    def _forces(self, state: State, seen: _Kinematics) -> tuple[Array, Array, Array]:
        """Return the forces of the bodies [B, T], of a point [10, T] and by gravity [3, T] in one state."""
        frame, place = seen.frame[:, self._bodies], (seen.origin - seen.centre)[:, self._bodies]
        projected, moving = (self._moves @ (each[..., None] * seen.axes) for each in (state.along, state.speed))
        gaining = self._moves @ (state.acceleration[..., None] * seen.axes + state.speed[..., None] * seen.rates)

        def own(vectors: Array) -> Array:
            """Return vectors of the world in the frames of the bodies, [T, B, 3]."""
            return (vectors[..., None, :] @ frame)[..., 0, :]

        turns, spins, spun = (own(each[..., :3]) for each in (projected, moving, gaining))
        passes, runs, pushed = (
            own(each[..., 3:] + _cross(each[..., :3], place)) for each in (projected, moving, gaining)
        )
        down = self._felt[:, None, None] * frame  # unit gravity along each axis of the world, in the bodies' frames
        force = pushed + _cross(spins, runs) - self._model.opt.gravity @ down
        point = _polynomial(passes, turns, force, spun, spins)
        # The first four moments: mass and mass times place.
        by_gravity = self._moments[:, 0, None] * passes + _cross(turns, self._moments[:, 1:4])
        return (
            np.einsum("bc,tbc->bt", self._moments, point),
            point[:, self._last].T,
            -(down @ by_gravity[..., None])[..., 0].sum(axis=1).T,
        )

    def _kinematics(self, states: Sequence[State], samples: slice) -> list[_Kinematics]:
        """Return MuJoCo's kinematics of all states."""
        mujoco, model, data = self._mujoco, self._model, self._mujoco.MjData(self._model)
        size, found, steps = len(states[0].position[samples]), list[_Kinematics](), []
        shapes = (model.nv, 6), (model.nv, 6), (model.nbody, 3), (model.nbody, 3), (model.nbody, 9)
        for state, before in zip(states, [None, *states], strict=False):
            moved = before is None or state.position is not before.position
            if moved:
                found.append(_Kinematics(*(np.empty((size, *shape)) for shape in shapes)))
            elif before is not None and state.speed is not before.speed:
                found.append(found[-1]._replace(rates=np.empty_like(found[-1].rates)))
            else:
                found.append(found[-1])
                continue
            steps.append((moved, state.position[samples], state.speed[samples], found[-1]))
        sources = data.cdof, data.xpos, data.subtree_com, data.xmat
        qpos, qvel, cdof_dot = data.qpos, data.qvel, data.cdof_dot
        for k in range(size):
            for moved, position, speed, seen in steps:
                if moved:
                    qpos[:] = position[k]
                    mujoco.mj_kinematics(model, data)
                    mujoco.mj_comPos(model, data)
                    for target, source in zip((seen.axes, seen.origin, seen.centre, seen.frame), sources, strict=True):
                        target[k] = source
                qvel[:] = speed[k]
                mujoco.mj_comVel(model, data)
                seen.rates[k] = cdof_dot
        roots = model.body_rootid
        return [each._replace(centre=each.centre[:, roots], frame=each.frame.reshape(size, -1, 3, 3)) for each in found]

    def _moments_of(self, body: int) -> Array:
        """Return the integral of `powers` over the mass of a body, [10], kg to kg m^2."""
        model, axes = self._model, np.zeros(9)
        self._mujoco.mju_quat2Mat(axes, model.body_iquat[body])
        frame, principal = axes.reshape(3, 3), model.body_inertia[body]
        second = frame @ np.diag(principal.sum() / 2 - principal) @ frame.T
        found = float(model.body_mass[body]) * powers(model.body_ipos[body])
        found[4:] += second[(0, 1, 2, 1, 0, 0), (0, 1, 2, 2, 2, 1)]
        return np.asarray(found)


def powers(place: Array) -> Array:
    """Return 1, x, y, z, xx, yy, zz, yz, xz, xy of a place [3]."""
    x, y, z = place
    return np.array([1.0, x, y, z, x * x, y * y, z * z, y * z, x * z, x * y])


def _polynomial(passes: Array, turns: Array, force: Array, spun: Array, spins: Array) -> Array:
    """Return the projected force of a point per kg, for each of `powers` of its place in the body's frame, [..., 10].

    Args:
        passes: projected speed of the frame's origin, [..., 3] as all.
        turns: projected angular velocity.
        force: acceleration of the origin less gravity.
        spun: angular acceleration.
        spins: angular velocity.
    """
    first = _cross(force, turns) + _cross(passes, spun)
    first += spins * _dot(passes, spins)[..., None] - passes * _dot(spins, spins)[..., None]
    second = _cross(spins, turns)[..., None] * spins[..., None, :] - turns[..., None] * spun[..., None, :]
    second += _dot(turns, spun)[..., None, None] * np.eye(3)
    squares = np.diagonal(second, axis1=-2, axis2=-1)
    products = (second + second.swapaxes(-1, -2))[..., (1, 0, 0), (2, 2, 1)]
    return np.concatenate([_dot(passes, force)[..., None], first, squares, products], axis=-1)


def _dot(one: Array, other: Array) -> Array:
    return np.asarray((one * other).sum(axis=-1))


def _cross(one: Array, other: Array) -> Array:
    """Return vector products [..., 3], faster than NumPy's for many short vectors."""
    (a, b, c), (x, y, z) = np.moveaxis(one, -1, 0), np.moveaxis(other, -1, 0)
    return np.stack((b * z - c * y, c * x - a * z, a * y - b * x), axis=-1)
