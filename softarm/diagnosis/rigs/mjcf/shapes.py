"""Shapes of a MuJoCo model's bodies, as points on the surfaces of their geoms."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from softarm.diagnosis.engine.view import Array

# Directions in which each geom has its outermost point: along the axes, and evenly over the sphere.
DIRECTIONS = 58
# Geoms of this group and below are drawn, as by MuJoCo's viewer.
GROUP = 2
# Radius of the rod that stands for a body without geoms, as a share of the mechanism's size.
ROD = 0.02


class Shapes:
    """Geoms of the bodies that move, and of the bodies that carry these."""

    def __init__(self, mujoco: Any, model: Any) -> None:
        """Compute the points of all geoms in the frames of their bodies."""
        self._mujoco, self._model = mujoco, model
        self._directions = _directions(DIRECTIONS)
        kinds = mujoco.mjtGeom
        self._undrawn = {int(kinds.mjGEOM_PLANE), int(kinds.mjGEOM_HFIELD), int(kinds.mjGEOM_SDF)}
        moving = [b for b in range(1, model.nbody) if model.body_weldid[b]]
        bodies = {*moving, *(int(model.body_parentid[b]) for b in moving)} - {0}
        found = [(b, points) for b in sorted(bodies) for points in self._of(b)]
        self._bodies, self._own = [b for b, _ in found], np.array([points for _, points in found])

    def points(self, positions: Array) -> Array:
        """Return the points of each geom along a motion, [T, G, P, 3], m; positions: qpos, [T, nq]."""
        data, found = self._mujoco.MjData(self._model), []
        for position in positions:
            data.qpos[:] = position
            self._mujoco.mj_kinematics(self._model, data)
            turned = np.einsum("gij,gpj->gpi", data.xmat[self._bodies].reshape(-1, 3, 3), self._own)
            found.append(data.xpos[self._bodies, None] + turned)
        return np.array(found)

    def _of(self, body: int) -> list[Array]:
        """Return the points of each geom of a body, [P, 3] each, or of a rod if it has none that can be drawn."""
        model = self._model
        geoms = [int(g) for g in np.flatnonzero(model.geom_bodyid == body) if model.geom_type[g] not in self._undrawn]
        seen = [g for g in geoms if model.geom_group[g] <= GROUP and model.geom_rgba[g, 3]] or geoms
        return [self._in_body(g) for g in seen] or self._rods(body)

    def _in_body(self, geom: int) -> Array:
        rotation = np.empty(9)
        self._mujoco.mju_quat2Mat(rotation, self._model.geom_quat[geom])
        return np.asarray(self._model.geom_pos[geom] + self._extreme(geom) @ rotation.reshape(3, 3).T)

    def _extreme(self, geom: int) -> Array:
        """Return the outermost points of a geom in its frame, [P, 3]."""
        kinds, towards = self._mujoco.mjtGeom, self._directions
        kind, size = int(self._model.geom_type[geom]), self._model.geom_size[geom]
        if kind == kinds.mjGEOM_SPHERE:
            return np.asarray(size[0] * towards)
        if kind == kinds.mjGEOM_CAPSULE:
            return _rod(-size[1] * np.eye(3)[2], size[1] * np.eye(3)[2], size[0], towards)
        if kind == kinds.mjGEOM_CYLINDER:
            level = towards * [1, 1, 0]
            across = level / np.maximum(np.linalg.norm(level, axis=1, keepdims=True), 1e-12)
            return np.asarray(size[0] * across + size[1] * np.sign(towards) * [0, 0, 1])
        if kind == kinds.mjGEOM_ELLIPSOID:
            return np.asarray(size**2 * towards / np.linalg.norm(size * towards, axis=1, keepdims=True))
        if kind == kinds.mjGEOM_BOX:
            return np.asarray(size * np.sign(towards))
        mesh = self._model.mesh(self._model.geom_dataid[geom])
        first = int(mesh.vertadr[0])
        vertices = self._model.mesh_vert[first : first + int(mesh.vertnum[0])]
        return np.asarray(vertices[np.argmax(vertices @ towards.T, axis=0)], float)

    def _rods(self, body: int) -> list[Array]:
        """Return rods from a body to the next ones, or through its centre of mass, in its frame."""
        model = self._model
        ends: Sequence[Array] = model.body_pos[model.body_parentid == body]
        ends = ends if len(ends) else [2 * model.body_ipos[body]]
        return [_rod(np.zeros(3), end, ROD * float(model.stat.extent), self._directions) for end in ends]


def _rod(start: Array, end: Array, radius: float, towards: Array) -> Array:
    """Return the outermost points of a capsule in some directions, [P, 3]."""
    return np.where(towards @ (end - start) > 0, end[:, None], start[:, None]).T + radius * towards


def _directions(number: int) -> Array:
    """Return unit vectors along the six half-axes, and a Fibonacci lattice of others, [number + 6, 3]."""
    height = 1 - (2 * np.arange(number) + 1) / number
    angle = np.pi * (1 + np.sqrt(5)) * np.arange(number)
    level = np.sqrt(1 - height**2)
    return np.concatenate((np.eye(3), -np.eye(3), np.stack((level * np.cos(angle), level * np.sin(angle), height), 1)))
