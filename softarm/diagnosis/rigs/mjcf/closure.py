"""Dependent joints of a model with equalities: closed chains, mimic joints and coupled tendons.

Coordinate partitioning (Wehage and Haug 1982, Generalized Coordinate Partitioning for Dimension Reduction in Analysis
of Constrained Dynamic Systems): the equalities determine the motion of the dependent degrees of freedom.
"""

import copy
from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.view import Array

# Newton steps at most, step at which they end (rad or m), and error of an equality up to which it is met (m or rad).
NEWTON_MOST, STEP_LEAST, MET = 20, 1e-6, 1e-5
# Steps from the model's zero to the first sample.
APPROACH = 20
# Time over which the Jacobian is differentiated, s.
DIFFERENCE_S = 1e-4
# Turn of every joint from the model's zero, where the number of dependent joints is counted: zeros are often singular.
AWAY = 0.1
# Share of a Jacobian's column below which it depends on earlier ones.
DEPENDS = 1e-6
# Ratio of two speeds from which one joint follows the other, rad or m per rad or m.
FOLLOWS = 1e-6
# Solved samples that are kept: the joints that carry a closed chain solve the same ones.
KEPT = 60_000


class State(NamedTuple):
    """Complete motion of a model at T samples."""

    position: Array  # qpos [T, nq]
    speed: Array  # qvel [T, nv]
    acceleration: Array  # qacc [T, nv]
    along: Array  # speed of every degree of freedom per speed of one independent one, [T, nv]
    closed: NDArray[np.bool_]  # whether the equalities can be met, [T]


class _Solution(NamedTuple):
    """Solved equalities at one sample: D dependent and L leading degrees of freedom, E equalities."""

    position: Array  # of the joints with dependent degrees of freedom
    inverse: Array  # [D, E] of the Jacobian
    ratios: Array  # [D, L] speeds of the dependent ones per speed of the leading ones
    closed: bool


class Closure:
    """Equalities of a model, solved for the dependent degrees of freedom.

    Attributes:
        dependent, independent: degrees of freedom.
        away: position away from the model's zero that meets the equalities, qpos [nq].
        follows: whether a degree of freedom moves with another, [nv, nv].
    """

    def __init__(self, mujoco: Any, model: Any, order: Sequence[int]) -> None:
        """Choose the dependent degrees of freedom.

        Args:
            mujoco: the module.
            model: the model.
            order: all degrees of freedom; the first become dependent if the equalities allow it.
        """
        self._mujoco, self._model = mujoco, copy.copy(model)
        flags, option = mujoco.mjtDisableBit, self._model.opt
        option.disableflags |= int(flags.mjDSBL_CONTACT) | int(flags.mjDSBL_LIMIT) | int(flags.mjDSBL_FRICTIONLOSS)
        option.jacobian = int(mujoco.mjtJacobian.mjJAC_DENSE)
        self._data = mujoco.MjData(self._model)
        way = AWAY * np.random.default_rng(0).uniform(0.5, 1.0, model.nv)
        jacobian = self._met(self._moved(model.qpos0, way))
        self.dependent = np.array(_dependent(jacobian, order), dtype=int)
        self.independent = np.setdiff1d(np.arange(model.nv), self.dependent)
        self.away, _, _ = self._closed(self._moved(model.qpos0, way))
        self.follows = np.abs(self.ratios(self.away)) > FOLLOWS
        followed = self.follows[np.ix_(self.dependent, self.independent)]
        self._leading = self.independent[followed.any(axis=0)]
        self._given, self._solved = self._coordinates(self._leading), self._coordinates(self.dependent)
        self._solutions, self._biases = dict[bytes, _Solution](), dict[bytes, Array]()

    @property
    def is_open(self) -> bool:
        """Return whether no joint depends on another."""
        return not len(self.dependent)

    def ratios(self, position: Array) -> Array:
        """Return the speed of every degree of freedom per speed of each independent one at a position, [nv, nv]."""
        jacobian, _ = self._equalities(position)
        found = np.zeros((self._model.nv, self._model.nv))
        found[self.independent, self.independent] = 1.0
        found[np.ix_(self.dependent, self.independent)] = -self._inverse(jacobian) @ jacobian[:, self.independent]
        return found

    def zero(self) -> Array:
        """Return the position nearest to the model's zero that meets the equalities, qpos [nq]."""
        return self._closed(self._model.qpos0)[0]

    def complete(
        self, position: Array, speed: Array, acceleration: Array, dof: int, near: Array | None = None
    ) -> State:
        """Return the motion with that of the dependent degrees of freedom, whose given values are ignored.

        Args:
            position, speed, acceleration: of the model, [T, nq], [T, nv] and [T, nv].
            dof: independent degree of freedom for `State.along`.
            near: closed positions to start from [T, nq]; without them each sample starts from the one before.
        """
        size, nv = speed.shape
        found = State(position.copy(), speed.copy(), acceleration.copy(), np.zeros((size, nv)), np.ones(size, bool))
        found.along[:, dof] = 1.0
        if self.is_open:
            return found
        if self._is_linear:
            self._follow(found, dof)
            return found
        last, leads = None, self._leading == dof
        for k in range(size):
            key = position[k, self._given].tobytes()
            if (solution := self._solutions.get(key)) is None:
                if near is not None:
                    last = near[k]
                elif last is None:
                    last = self._approached(position[k])
                solution = self._solve(position[k], last)
                _keep(self._solutions, key, solution)
            found.position[k, self._solved], found.closed[k] = solution.position, solution.closed
            last, moved = found.position[k], speed[k, self._leading]
            found.speed[k, self.dependent] = solution.ratios @ moved
            found.along[k, self.dependent] = solution.ratios @ leads
            key += moved.tobytes()
            if (bias := self._biases.get(key)) is None:
                _keep(self._biases, key, bias := self._bias(last, solution.inverse, found.speed[k]))
            found.acceleration[k, self.dependent] = solution.ratios @ acceleration[k, self._leading] + bias
        return found

    @cached_property
    def _is_linear(self) -> bool:
        """Return whether all equalities are constant ratios of two joints, as of mimic joints."""
        active = self._model.eq_active0.astype(bool)
        joints = self._model.eq_type[active] == int(self._mujoco.mjtEq.mjEQ_JOINT)
        return bool(joints.all() and not self._model.eq_data[active, 2:5].any())

    @cached_property
    def _constant(self) -> tuple[Array, Array]:
        """Position at the model's zero, qpos [nq], and the ratios everywhere, [D, L], of linear equalities."""
        zero = self.zero()
        return zero, self._solve(zero, zero).ratios

    def _follow(self, found: State, dof: int) -> None:
        """Set the motion of the dependent degrees of freedom of linear equalities; see `complete`."""
        zero, ratios = self._constant
        joints = self._model.dof_jntid
        solved, given = (self._model.jnt_qposadr[joints[dofs]] for dofs in (self.dependent, self._leading))
        found.position[:, solved] = zero[solved] + (found.position[:, given] - zero[given]) @ ratios.T
        for rates in (found.speed, found.acceleration, found.along):
            rates[:, self.dependent] = rates[:, self._leading] @ ratios.T

    def _coordinates(self, dofs: Array) -> NDArray[np.int64]:
        """Return the indices in qpos of the joints of some degrees of freedom."""
        m = self._model
        ends = np.append(m.jnt_qposadr[1:], m.nq)
        blocks = [np.arange(m.jnt_qposadr[j], ends[j]) for j in np.unique(m.dof_jntid[dofs])]
        return np.concatenate([np.arange(0), *blocks])

    def _solve(self, position: Array, near: Array) -> _Solution:
        """Return the solution at a position, from a closed one near it."""
        start = position.copy()
        self._take_dependent(start, near)
        closed, jacobian, met = self._closed(start)
        inverse = self._inverse(jacobian)
        return _Solution(closed[self._solved], inverse, -inverse @ jacobian[:, self._leading], met)

    def _approached(self, goal: Array) -> Array:
        """Return a closed position near the first sample, reached from the model's zero in small steps."""
        way, found = np.zeros(self._model.nv), self.zero()
        self._mujoco.mj_differentiatePos(self._model, way, 1.0, self._model.qpos0, goal)
        for share in np.linspace(0.0, 1.0, APPROACH + 1)[1:]:
            position = self._moved(self._model.qpos0, share * way)
            self._take_dependent(position, found)
            found, *_ = self._closed(position)
        return found

    def _take_dependent(self, position: Array, source: Array) -> None:
        """Set the dependent coordinates of a position to those of another."""
        way = np.zeros(self._model.nv)
        self._mujoco.mj_differentiatePos(self._model, way, 1.0, position, source)
        way[self.independent] = 0.0
        self._mujoco.mj_integratePos(self._model, position, way, 1.0)

    def _closed(self, position: Array) -> tuple[Array, Array, bool]:
        """Return the position with solved dependent coordinates, the Jacobian there, and whether they meet all."""
        position, step = np.array(position, dtype=float), np.zeros(self._model.nv)
        if self.is_open:
            return position, np.zeros((0, self._model.nv)), True
        for _ in range(NEWTON_MOST):
            jacobian, error = self._equalities(position)
            step[self.dependent] = -self._inverse(jacobian) @ error
            self._mujoco.mj_integratePos(self._model, position, np.clip(step, -AWAY, AWAY), 1.0)
            if np.abs(step).max() < STEP_LEAST:
                break
        jacobian, error = self._equalities(position)
        return position, jacobian, bool(np.abs(error).max(initial=0.0) < MET)

    def _met(self, position: Array) -> Array:
        """Return the Jacobian where all joints have met the equalities [E, nv].

        Elsewhere, joints that carry both ends of a loop have a share in closing it.
        """
        jacobian, error = self._equalities(position)
        for _ in range(NEWTON_MOST if len(error) else 0):
            step = -np.linalg.lstsq(jacobian, error, rcond=DEPENDS)[0]
            position = self._moved(position, np.clip(step, -AWAY, AWAY))
            jacobian, error = self._equalities(position)
            if np.abs(step).max() < STEP_LEAST:
                break
        return jacobian

    def _inverse(self, jacobian: Array) -> Array:
        """Return the pseudoinverse of the columns of the dependent degrees of freedom, [D, E]."""
        own = jacobian[:, self.dependent]
        try:
            return np.asarray(np.linalg.solve(own.T @ own, own.T))  # a quarter of the time of the general one
        except np.linalg.LinAlgError:
            return np.asarray(np.linalg.pinv(own))

    def _bias(self, position: Array, inverse: Array, speed: Array) -> Array:
        """Return the accelerations of the dependent degrees of freedom at constant speed of the others, [D]."""
        (after, _), (before, _) = (
            self._equalities(self._moved(position, sign * DIFFERENCE_S * speed)) for sign in (1.0, -1.0)
        )
        return np.asarray(-inverse @ ((after - before) @ speed / (2 * DIFFERENCE_S)))

    def _moved(self, position: Array, way: Array) -> Array:
        moved = np.array(position, dtype=float)
        self._mujoco.mj_integratePos(self._model, moved, way, 1.0)
        return moved

    def _equalities(self, position: Array) -> tuple[Array, Array]:
        """Return Jacobian [E, nv] and errors [E] of the active equalities at a position."""
        data, nv = self._data, self._model.nv
        data.qpos[:] = position
        self._mujoco.mj_fwdPosition(self._model, data)
        return np.array(data.efc_J).ravel()[: data.ne * nv].reshape(data.ne, nv), np.array(data.efc_pos[: data.ne])


def _keep(store: dict[bytes, Any], key: bytes, value: object) -> None:
    """Store a value; a full store is emptied."""
    if len(store) >= KEPT:
        store.clear()
    store[key] = value


def _dependent(jacobian: Array, order: Sequence[int]) -> list[int]:
    """Return the columns of a Jacobian in an order, each linearly independent of those before it."""
    found, basis = list[int](), np.zeros((len(jacobian), 0))
    most = float(np.linalg.norm(jacobian, axis=0).max(initial=0.0))
    for column in order:
        rest = jacobian[:, column] - basis @ (basis.T @ jacobian[:, column])
        if (size := float(np.linalg.norm(rest))) > DEPENDS * most:
            found.append(column)
            basis = np.column_stack([basis, rest / size])
    return found
