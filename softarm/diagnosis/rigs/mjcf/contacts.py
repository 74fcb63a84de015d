"""Contacts of bodies and limits of tendons, which act on a joint with an unknown force."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.view import Array


class Contacts:
    """Contacts and tendons of a MuJoCo model."""

    def __init__(self, mujoco: Any, model: Any) -> None:
        """Note whether the model's geoms can touch each other."""
        self._mujoco, self._model = mujoco, model
        self._touches = bool(model.ngeom and (model.geom_contype | model.geom_conaffinity).any())

    def act(self, positions: Array, moved: Sequence[int], joints: NDArray[np.int_]) -> NDArray[np.bool_]:
        """Return whether a contact or a tendon's limit acts on a joint at each position, [T].

        Args:
            positions: qpos, [T, nq].
            moved: bodies that the joint moves.
            joints: the joint and those that follow it.
        """
        found = np.zeros(len(positions), bool)
        tendons = self._limited(moved, joints)
        if not self._touches and not tendons:
            return found
        low, high = self._model.tendon_range[tendons].T
        data = self._mujoco.MjData(self._model)
        for k, position in enumerate(positions):
            self._place(data, position)
            if tendons:
                self._mujoco.mj_tendon(self._model, data)
                length = data.ten_length[tendons]
                found[k] |= bool(((length <= low) | (length >= high)).any())
            found[k] |= len(self._pairs(data, moved)) > 0
        return found

    def most(self, positions: Array, moved: Sequence[int]) -> tuple[str, str, int] | None:
        """Return the names of the two bodies that touch most often, and at how many positions; see `act`."""
        data, found = self._mujoco.MjData(self._model), Counter[tuple[int, int]]()
        for position in positions:
            self._place(data, position)
            found.update({(int(one), int(other)) for one, other in self._pairs(data, moved)})
        if not found:
            return None
        ((one, other), times) = found.most_common(1)[0]
        return self._name(one), self._name(other), times

    def _place(self, data: Any, position: Array) -> None:
        data.qpos[:] = position
        self._mujoco.mj_kinematics(self._model, data)
        self._mujoco.mj_comPos(self._model, data)

    def _pairs(self, data: Any, moved: Sequence[int]) -> NDArray[np.int_]:
        """Return the pairs of touching bodies of which a joint moves one, [N, 2]; data: with its bodies in place."""
        self._mujoco.mj_collision(self._model, data)
        if not data.ncon:
            return np.empty((0, 2), int)
        bodies = self._model.geom_bodyid[data.contact.geom[data.contact.exclude == 0]]  # the others have no force
        moves = np.isin(bodies, moved)
        return np.asarray(bodies[moves[:, 0] != moves[:, 1]])

    def _name(self, body: int) -> str:
        return str(self._model.body(body).name) or f"body{body}"

    def _limited(self, moved: Sequence[int], joints: NDArray[np.int_]) -> list[int]:
        """Return the tendons with a limit whose length a joint changes."""
        model, wraps = self._model, self._mujoco.mjtWrap
        found = []
        for tendon in np.flatnonzero(model.tendon_limited):
            path = model.tendon_adr[tendon] + np.arange(model.tendon_num[tendon])
            kinds, objects = model.wrap_type[path], model.wrap_objid[path]
            carried = np.isin(model.site_bodyid[objects[kinds == wraps.mjWRAP_SITE]], moved)
            if np.isin(objects[kinds == wraps.mjWRAP_JOINT], joints).any() or (carried.any() and not carried.all()):
                found.append(int(tendon))
        return found
