"""Torque of muscles and of other actuators whose strength changes with the motion.

MuJoCo's force is gain times activation plus bias. The command alone makes the activation, and the motion alone makes
gain and bias (MuJoCo's documentation, Computation: Force generation). So both are computed once along the recording.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.mjcf.closure import State

# Longest integration step of a muscle's activation, s.
STEP_S = 1e-3
# Time in which an unknown activation fades, in time constants; a muscle's are up to twice as long as stated.
SETTLES, MUSCLE_SLOWER = 4.0, 2.0


class Strength(NamedTuple):
    """Torque of an actuator about one joint along a motion, [T] each."""

    active: Array  # per activation
    passive: Array  # without activation


class Activation:
    """Activation and strength of the actuators of a model, by their numbers."""

    def __init__(self, mujoco: Any, model: Any) -> None:
        self._mujoco, self._model = mujoco, model
        dyn, gain, bias = mujoco.mjtDyn, mujoco.mjtGain, mujoco.mjtBias
        self._filters = int(dyn.mjDYN_FILTER), int(dyn.mjDYN_FILTEREXACT)
        self._muscle = int(dyn.mjDYN_MUSCLE), int(gain.mjGAIN_MUSCLE), int(bias.mjBIAS_MUSCLE)
        self._laws = (
            (int(dyn.mjDYN_NONE), *self._filters, self._muscle[0]),
            (int(gain.mjGAIN_FIXED), int(gain.mjGAIN_AFFINE), self._muscle[1]),
            (int(bias.mjBIAS_NONE), int(bias.mjBIAS_AFFINE), self._muscle[2]),
        )

    def knows(self, i: int) -> bool:
        """Return whether an actuator's law is known here: that of a plug-in, or with a force range, is not."""
        m = self._model
        own = m.actuator_dyntype[i], m.actuator_gaintype[i], m.actuator_biastype[i]
        known = all(kind in laws for kind, laws in zip(own, self._laws, strict=True))
        return known and not m.actuator_forcelimited[i]

    def settles_s(self, i: int) -> float:
        """Return the time in which an unknown activation fades, s."""
        kind, parameters = self._model.actuator_dyntype[i], self._model.actuator_dynprm[i]
        if kind == self._muscle[0]:
            return SETTLES * MUSCLE_SLOWER * float(max(parameters[:2]))
        return SETTLES * float(parameters[0]) if kind in self._filters else 0.0

    def peak(self, i: int) -> float:
        """Return the largest active force of a muscle, N, or 0; see MuJoCo's documentation, `muscle`, `force`."""
        m = self._model
        if m.actuator_gaintype[i] != self._muscle[1]:
            return 0.0
        force, scale = (float(each) for each in m.actuator_gainprm[i, 2:4])
        return force if force >= 0 else scale / max(float(m.actuator_acc0[i]), 1e-300)

    def of(self, i: int, command: Array, step_s: float) -> Array:
        """Return the activation of an actuator with a time constant at each sample, [T], from that of a held command.

        Args:
            i: number of the actuator.
            command: mean command in the step before each sample, [T], within its range.
            step_s: time between two samples.
        """
        steps = max(math.ceil(step_s / STEP_S), 1)
        is_muscle = self._model.actuator_dyntype[i] == self._muscle[0]
        rate = self._muscle_rate if is_muscle else self._filter_rate
        parameters, now, found = self._model.actuator_dynprm[i], float(command[0]), np.empty_like(command)
        for k, wanted in enumerate(command):
            for _ in range(steps):
                now += step_s / steps * rate(wanted, now, parameters)
            found[k] = now
        return found

    def _muscle_rate(self, wanted: float, now: float, parameters: Array) -> float:
        return float(self._mujoco.mju_muscleDynamics(wanted, now, parameters[:3]))

    @staticmethod
    def _filter_rate(wanted: float, now: float, parameters: Array) -> float:
        return (wanted - now) / max(float(parameters[0]), STEP_S)

    def strengths(self, own: list[int], motion: State) -> list[Strength]:
        """Return the strengths of some actuators; motion: of the whole model, with `along` of the joint."""
        mujoco, model, data = self._mujoco, self._model, self._mujoco.MjData(self._model)
        found = np.empty((2, len(own), len(motion.position)))
        for k in range(len(motion.position)):
            data.qpos[:] = motion.position[k]
            for stage in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_tendon, mujoco.mj_transmission):
                stage(model, data)
            moments = moments_of(mujoco, model, data)[own]
            speeds, levers = moments @ motion.speed[k], moments @ motion.along[k]
            for n, (i, speed, lever) in enumerate(zip(own, speeds, levers, strict=True)):
                length = float(data.actuator_length[i])
                found[:, n, k] = lever * self._gain(i, length, speed), lever * self._bias(i, length, speed)
        return [Strength(*each) for each in found.swapaxes(0, 1)]

    def _gain(self, i: int, length: float, speed: float) -> float:
        m, parameters = self._model, self._model.actuator_gainprm[i]
        if m.actuator_gaintype[i] == self._muscle[1]:
            span, force = m.actuator_lengthrange[i], m.actuator_acc0[i]
            return float(self._mujoco.mju_muscleGain(length, speed, span, force, parameters[:9]))
        affine = m.actuator_gaintype[i] == self._laws[1][1]
        return float(parameters[0] + affine * (parameters[1] * length + parameters[2] * speed))

    def _bias(self, i: int, length: float, speed: float) -> float:
        m, parameters = self._model, self._model.actuator_biasprm[i]
        if m.actuator_biastype[i] == self._muscle[2]:
            span, force = m.actuator_lengthrange[i], m.actuator_acc0[i]
            return float(self._mujoco.mju_muscleBias(length, span, force, parameters[:9]))
        affine = m.actuator_biastype[i] == self._laws[2][1]
        return float(affine * (parameters[0] + parameters[1] * length + parameters[2] * speed))


def moments_of(mujoco: Any, model: Any, data: Any) -> Array:
    """Return the moments of all actuators about all degrees of freedom at the position of `data`, [nu, nv]."""
    found = np.zeros((model.nu, model.nv))
    mujoco.mju_sparse2dense(
        found, data.actuator_moment.ravel(), data.moment_rownnz, data.moment_rowadr, data.moment_colind.ravel()
    )
    return found
