"""Actuators of a MuJoCo model, and the joints that they move."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.mjcf.activation import Activation, Strength, moments_of
from softarm.diagnosis.rigs.mjcf.closure import Closure, State

# Share of an actuator's largest moment below which it moves no joint, and of a moment that changes with position.
MOVES = 1e-6
# Fastest swing of a position loop, rad/s, whose torque the measured motion shows: 4 Hz.
FASTEST_RAD_S = 8 * np.pi


@dataclass(frozen=True, slots=True)
class Actuator:
    """Affine actuator as one joint feels it: joint torque = scale command + offset - kp position - kd speed, clipped.

    The scale of an actuator with another law, such as a muscle, is 0.

    Units are those of the joint's torque (N m or N) and position (rad or m). An actuator on a tendon over several
    joints feels the others as well: kp position becomes kp (position + along / gear), where `along` is its length by
    the positions of the others, and kd speed likewise.
    """

    name: str
    scale: float = 1.0
    offset: float = 0.0
    kp: float = 0.0
    kd: float = 0.0
    low: float = -np.inf  # without a limit
    high: float = np.inf
    command_low: float = -np.inf
    command_high: float = np.inf
    lag_s: float = 0.0
    delay_s: float = 0.0
    gear: float = 1.0  # joint torque per torque of the actuator, and actuator's length per position
    own_gear: float = 1.0  # attribute `gear`; the rest of the gear is that of a tendon or an equality
    joint_limited: bool = False  # by `actuatorfrcrange` of its joint, besides its own range
    settles_s: float = 0.0  # time in which an unknown activation at the start of a recording fades
    peak: float = 0.0  # largest active force of a muscle, N
    others: Mapping[str, float] = field(default_factory=dict)  # other joint that it moves -> length per position
    # Of several actuators at one joint, such as an antagonistic pair: each by its name. Their sum has a scale of one.
    shares: Mapping[str, "Actuator"] = field(default_factory=dict)
    by_motion: bool = False  # strengths of `shares` change with the motion; see `Activation`

    def sent(self, command: Callable[[str], Array]) -> Array:
        """Return the command within its range at each sample, [T]; of several actuators the sum of their torques.

        Args:
            command: returns the command of an actuator by its name, [T].
        """
        if not self.shares:
            return np.clip(command(self.name), self.command_low, self.command_high)
        return np.asarray(sum(each.given(command) for each in self.shares.values()))

    def given(self, command: Callable[[str], Array]) -> Array:
        """Return the joint torque of an actuator without a loop at each sample, [T]; see `sent`."""
        return self.torque(self.sent(command), np.zeros(1), np.zeros(1))

    def torque(self, command: Array, position: Array, speed: Array) -> Array:
        """Return the joint torque at each sample, [T each]."""
        drive = self.scale * command + self.offset - self.kp * position - self.kd * speed
        return np.asarray(np.clip(drive, self.low, self.high))


class Actuators:
    """All actuators of a model, by the joint that they move."""

    def __init__(self, mujoco: Any, model: Any, closure: Closure, name_of: Callable[[str, int], str]) -> None:
        """Find which independent degrees of freedom each actuator moves; name_of("joint", number) returns a name."""
        self._mujoco, self._model, self._name_of = mujoco, model, name_of
        self._activation = Activation(mujoco, model)
        self._zero = closure.zero()
        self._moments, self._lengths = self._transmission(closure, self._zero)
        self._elsewhere, _ = self._transmission(closure, closure.away)
        self._most = np.maximum(np.abs(self._moments), np.abs(self._elsewhere)).max(axis=1, initial=1e-300)

    def of(self, dof: int) -> tuple[Actuator | None, str]:
        """Return the actuator of an independent degree of freedom, or None, and why the model's cannot be used."""
        own = [i for i in range(self._model.nu) if self._moves(i)[dof]]
        number = int(self._model.dof_jntid[dof])
        joint = self._name_of("joint", number)
        if not own:
            return None, ""
        found = [self._read(i, dof, number) for i in own]
        instead = f"give its torque under `torque`, as {joint}"
        if all(self._is_affine(i) and self._is_linear(i) for i in own):
            if len(found) == 1:
                return found[0], ""
            if all(_may_share(each, found[0]) for each in found):
                return _joined(found), ""
        names = ", ".join(each.name for each in found)
        if self._swings(own, dof) > FASTEST_RAD_S:
            return None, (
                f"joint {joint} is moved by {names}: beside another actuator, or at a tendon with changing ratios, a "
                "position loop may swing at 4 Hz at most, since the measured motion shows the torque of no faster "
                f"one; {instead}"
            )
        if dotted := [each.name for each in found if "." in each.name]:
            return None, (
                f"joint {joint} is moved by {dotted[0]}: its name holds a dot, which separates the parts of an "
                f"effect's name; rename the actuator in the model and the column, or {instead}"
            )
        if not all(map(self._activation.knows, own)):
            return None, (
                f"joint {joint} is moved by {names}; several actuators, and those whose strength changes with the "
                "motion, are allowed with a fixed, affine or muscle's gain and bias, with a filter's or a muscle's "
                f"activation, and without a force range; write them so, or {instead}"
            )
        return _by_motion(found, *self._joint_range(number)), ""

    def _swings(self, own: Sequence[int], dof: int) -> float:
        """Return the frequency at which position loops swing a joint, rad/s; 0 without one."""
        m = self._model
        moments = np.maximum(np.abs(self._moments[own, dof]), np.abs(self._elsewhere[own, dof]))
        is_affine = m.actuator_biastype[own] == int(self._mujoco.mjtBias.mjBIAS_AFFINE)
        stiffness = float(moments**2 @ np.maximum(-m.actuator_biasprm[own, 1] * is_affine, 0.0))
        return math.sqrt(stiffness * float(m.dof_invweight0[dof]))

    def activation(self, name: str, command: Array, step_s: float) -> Array:
        """Return the activation of an actuator at each sample, [T]; see `Activation.of`."""
        return self._activation.of(self._number(name), command, step_s)

    def strengths(self, names: Iterable[str], motion: State) -> list[Strength]:
        """Return the strengths of some actuators about one joint; see `Activation.strengths`."""
        return self._activation.strengths([*map(self._number, names)], motion)

    def _number(self, name: str) -> int:
        return next(i for i in range(self._model.nu) if self._name_of("actuator", i) == name)

    def _transmission(self, closure: Closure, position: Array) -> tuple[Array, Array]:
        """Return moments about the independent degrees of freedom [nu, nv] and lengths [nu] at a position."""
        mujoco, model, data = self._mujoco, self._model, self._mujoco.MjData(self._model)
        data.qpos[:] = position
        mujoco.mj_forward(model, data)
        return moments_of(mujoco, model, data) @ closure.ratios(position), np.array(data.actuator_length)

    def _moves(self, i: int) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Return which degrees of freedom an actuator moves, [nv]."""
        moments = np.maximum(np.abs(self._moments[i]), np.abs(self._elsewhere[i]))
        return np.asarray(moments > MOVES * self._most[i])

    def _is_affine(self, i: int) -> bool:
        m, gain, bias, dyn = self._model, self._mujoco.mjtGain, self._mujoco.mjtBias, self._mujoco.mjtDyn
        affine = m.actuator_gaintype[i] == int(gain.mjGAIN_FIXED)
        affine &= m.actuator_biastype[i] in map(int, (bias.mjBIAS_NONE, bias.mjBIAS_AFFINE))
        return bool(
            affine & (m.actuator_dyntype[i] in map(int, (dyn.mjDYN_NONE, dyn.mjDYN_FILTER, dyn.mjDYN_FILTEREXACT)))
        )

    def _is_linear(self, i: int) -> bool:
        """Return whether an actuator's length is a sum of multiples of the positions of hinges and slides."""
        m, kinds, slack = self._model, self._mujoco.mjtJoint, MOVES * self._most[i]
        numbers = m.dof_jntid[np.flatnonzero(self._moves(i))]
        single = np.isin(m.jnt_type[numbers], (int(kinds.mjJNT_HINGE), int(kinds.mjJNT_SLIDE))).all()
        length = self._moments[i, m.jnt_dofadr[numbers]] @ self._zero[m.jnt_qposadr[numbers]]
        constant = np.abs(self._moments[i] - self._elsewhere[i]).max() < slack
        return bool(single and constant and abs(self._lengths[i] - length) < slack)

    def _read(self, i: int, dof: int, number: int) -> Actuator:
        m, mujoco = self._model, self._mujoco
        gear, own_gear = float(self._moments[i, dof]), float(m.actuator_gear[i, 0])
        bias = m.actuator_biasprm[i] * (m.actuator_biastype[i] != int(mujoco.mjtBias.mjBIAS_NONE))
        low, high = self._joint_range(number)
        if m.actuator_forcelimited[i]:
            least, most = sorted(gear * float(x) for x in m.actuator_forcerange[i])
            low, high = max(low, least), min(high, most)
        ctrl = m.actuator_ctrlrange[i] if m.actuator_ctrllimited[i] else (-np.inf, np.inf)
        delay = getattr(m, "actuator_delay", None)
        return Actuator(
            name=self._name_of("actuator", i),
            scale=gear * float(m.actuator_gainprm[i, 0]) * self._is_affine(i),
            offset=gear * float(bias[0]),
            kp=-gear * gear * float(bias[1]),
            kd=-gear * gear * float(bias[2]),
            low=low,
            high=high,
            command_low=float(ctrl[0]),
            command_high=float(ctrl[1]),
            lag_s=float(m.actuator_dynprm[i, 0]) if m.actuator_dyntype[i] != int(mujoco.mjtDyn.mjDYN_NONE) else 0.0,
            delay_s=0.0 if delay is None else float(delay[i]),
            gear=gear,
            own_gear=own_gear,
            joint_limited=bool(m.jnt_actfrclimited[number]),
            settles_s=self._activation.settles_s(i),
            peak=self._activation.peak(i),
            others={
                self._name_of("joint", int(m.dof_jntid[other])): float(self._moments[i, other])
                for other in np.flatnonzero(self._moves(i))
                if other != dof
            },
        )

    def _joint_range(self, number: int) -> tuple[float, float]:
        """Return the lowest and the highest torque of all actuators at a joint."""
        m = self._model
        low, high = m.jnt_actfrcrange[number] if m.jnt_actfrclimited[number] else (-np.inf, np.inf)
        return float(low), float(high)


def _may_share(actuator: Actuator, first: Actuator) -> bool:
    """Return whether an actuator may move a joint together with another: a motor that is as slow and as late.

    The limit of a slow motor acts behind its lag, which the sum of the commands has not passed.
    """
    is_motor = not actuator.kp and not actuator.kd and not actuator.joint_limited
    limited = np.isfinite(actuator.low) or np.isfinite(actuator.high)
    alike = (actuator.lag_s, actuator.delay_s) == (first.lag_s, first.delay_s)
    return bool(is_motor and alike and not (limited and actuator.lag_s) and "." not in actuator.name)


def _joined(actuators: Sequence[Actuator]) -> Actuator:
    """Return the sum of several motors at one joint, whose command is their torque."""
    first = actuators[0]
    return Actuator(
        " and ".join(each.name for each in actuators),
        lag_s=first.lag_s,
        delay_s=first.delay_s,
        settles_s=first.settles_s,
        others={name: ratio for each in actuators for name, ratio in each.others.items()},
        shares={each.name: each for each in actuators},
    )


def _by_motion(actuators: Sequence[Actuator], low: float, high: float) -> Actuator:
    """Return the sum of actuators whose strengths change with the motion; low, high: range of their torque."""
    slowest_s = max(each.settles_s for each in actuators)
    return replace(_joined(actuators), lag_s=0.0, delay_s=0.0, low=low, high=high, settles_s=slowest_s, by_motion=True)
