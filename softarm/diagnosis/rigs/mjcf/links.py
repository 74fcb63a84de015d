"""Rigid links of a MuJoCo model: the last one behind a joint, and changes of a link's length and load."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from softarm.diagnosis.engine.view import Array

# Distance of a link's centre of mass from its joint below which the link is balanced.
SHORTEST_M = 1e-3
# Most links of a finger; an arm of a humanoid has more. Two fingers have at most this ratio of masses.
FINGER_LINKS, FINGER_RATIO = 2, 2.0
# Least usual distance of a payload from the last joint, as a share of the mechanism's length: a tool is longer than the
# flange that carries it.
TOOL = 0.1
# Parameters of a payload's place, one for each axis of its link.
PLACE = "distance", "y", "z"


@dataclass(frozen=True, slots=True)
class Link:
    """Rigid link at the end of a mechanism, in the frame of the body that its joint carries."""

    number: int
    body: str  # its name
    start: Array  # [3] place of the joint, m
    axes: Array  # [3, 3] in rows: towards the link's centre of mass, and two across; 0 for a balanced link
    reach_m: float  # usual distance of a payload from the start; 0 for a balanced link
    is_short: bool = False  # a flange, whose centre of mass does not show on which side a tool is

    def place(self, at_m: Sequence[float]) -> Array:
        """Return a place in the frame of the body, [3]; at_m: distances from the start along the three axes."""
        return np.asarray(self.start + np.asarray(at_m) @ self.axes)


class Links:
    """Links of a model: bodies without a joint between them."""

    def __init__(self, mujoco: Any, model: Any) -> None:
        """Compute the centres of mass of a model with all joints at zero."""
        self._mujoco, self._model, self._data = mujoco, model, mujoco.MjData(model)
        mujoco.mj_forward(model, self._data)

    def last(self, moved: list[int]) -> Link:
        """Return the link at the end of a mechanism, from the bodies that a joint moves.

        Fingers are no end: a tool, a camera or an item in the hand loads the link that carries them.
        """
        model, data = self._model, self._data
        tip = self._link(moved[-1])
        root = self._palm(tip, moved) or tip
        start = model.jnt_pos[model.body_jntadr[root] + model.body_jntnum[root] - 1].copy()
        centre = self._from(root, self._centre(root)) - start
        name, distance = str(model.body(root).name) or f"body{root}", float(np.linalg.norm(centre))
        if distance < SHORTEST_M:
            return Link(root, name, start + centre, np.zeros((3, 3)), 0.0)
        direction = centre / distance
        across = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
        across /= np.linalg.norm(across)
        axes = np.stack((direction, across, np.cross(direction, across)))
        fingers = [] if root == tip else [self._from(root, data.subtree_com[each]) for each in self._next(root)]
        reaches = [distance, *(float((at - start) @ direction) for at in fingers)]
        tool = TOOL * self._length(root)
        return Link(root, name, start, axes, max(*reaches, tool), is_short=max(reaches) < tool)

    def stretch(self, model: Any, body: int, factor: float) -> None:
        """Move everything on the rigid link of a body, the next joints included, away from its joint."""
        start = model.jnt_pos[model.body_jntadr[body] + model.body_jntnum[body] - 1]
        for i in range(body, model.nbody):
            if model.body_weldid[model.body_parentid[i]] == body:
                model.body_pos[i] = start + factor * (model.body_pos[i] - start)
            if model.body_weldid[i] == body:
                origin = start if i == body else 0.0
                model.body_ipos[i] = origin + factor * (model.body_ipos[i] - origin)
                model.body_inertia[i] *= factor**2
                model.body_sameframe[i] = model.body_simple[i] = 0
        model.dof_simplenum[:] = 0

    def _palm(self, tip: int, moved: list[int]) -> int | None:
        """Return the moved link that carries the last link as one of several fingers, if any."""
        finger = tip
        for _ in range(FINGER_LINKS):
            palm = self._link(int(self._model.body_parentid[finger]))
            if palm not in moved:
                return None
            others = [each for each in self._next(palm) if each != finger]
            if others:
                return palm if any(self._alike(finger, each) for each in others) else None
            finger = palm
        return None

    def _alike(self, finger: int, other: int) -> bool:
        """Return whether another branch is a finger as well, and about as heavy."""
        masses = self._model.body_subtreemass[[finger, other]]
        tip, links = other, 1
        while following := self._next(tip):
            tip, links = following[0], links + len(following)
        return links <= FINGER_LINKS and bool(masses.max() < FINGER_RATIO * masses.min())

    def _length(self, body: int) -> float:
        """Return the length of a mechanism from its first joint to a body, along its bodies, m."""
        model, found = self._model, 0.0
        while self._link(int(model.body_parentid[body])):
            found += float(np.linalg.norm(model.body_pos[body]))
            body = int(model.body_parentid[body])
        return found

    def _link(self, body: int) -> int:
        """Return the first body of a body's link."""
        return int(self._model.body_weldid[body])

    def _next(self, link: int) -> list[int]:
        """Return the first bodies of the links that a link carries."""
        model = self._model
        own = np.flatnonzero(model.body_weldid == np.arange(model.nbody))
        return [int(each) for each in own if each and self._link(int(model.body_parentid[each])) == link]

    def _centre(self, link: int) -> Array:
        """Return a link's centre of mass in the model's frame, [3]."""
        parts = np.flatnonzero(self._model.body_weldid == link)
        mass = self._model.body_mass[parts]
        return np.asarray(mass @ self._data.xipos[parts] / max(float(mass.sum()), 1e-12))

    def _from(self, body: int, place: Array) -> Array:
        """Return a place of the model's frame in the frame of a body, [3]."""
        return np.asarray(self._data.xmat[body].reshape(3, 3).T @ (place - self._data.xpos[body]))
