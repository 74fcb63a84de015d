"""Effects of a verdict that MJCF cannot express, applied while MuJoCo simulates the patched model.

Everything is an array with joints last, so that a batch of environments needs no loop, and the state is passed in and
out. With `xp=jax.numpy` the same functions run inside `jax.jit`, as in MuJoCo Playground.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.data.trials import TrialError
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.mjcf.mechanism import Joint, mechanism
from softarm.diagnosis.rigs.mjcf.patch import agreed, standard
from softarm.schemas.verdict import Verdict

# Parameter of a verdict -> field of `Parameters`; everything else of a verdict is in the patched model.
_FIELDS = {
    "dead_time.delay": "dead_time_s",
    "latency.delay": "latency_s",
    "rate_limit.rate": "rate_per_s",
    "command_bias.bias": "command_bias",
    "deadband.width": "deadband",
    "torque_offset.torque": "torque_offset",
    "drag.coefficient": "drag",
    "stiction.torque": "stiction",
    "stiction.speed": "stiction_speed",
    "load_friction.share": "load_share",
    "load_friction.from_load": "load_part",
    "load_friction.speed": "load_speed",
    "backlash.gap": "backlash",
    "sensor_bias.bias": "sensor_bias",
}

_OF_LOOP = "rate_per_s", "command_bias", "deadband"


class Parameters(NamedTuple):
    """Sizes of the effects, [..., J] each, in s, rad or m, and N m or N."""

    dead_time_s: Any = 0.0
    latency_s: Any = 0.0
    rate_per_s: Any = np.inf
    command_bias: Any = 0.0
    deadband: Any = 0.0
    torque_offset: Any = 0.0
    drag: Any = 0.0
    stiction: Any = 0.0
    stiction_speed: Any = 1.0
    load_share: Any = 0.0
    load_part: Any = 0.0
    load_speed: Any = np.inf
    backlash: Any = 0.0
    sensor_bias: Any = 0.0


class Motion(NamedTuple):
    """Motion and torques of the joints, [..., J] each."""

    position: Any
    speed: Any
    # Of the actuator: `qfrc_actuator`, or `actuator_force` times `gear` of a joint that others follow by an equality.
    torque: Any
    load: Any  # `qfrc_bias`


class State(NamedTuple):
    """Memory of the effects between steps."""

    sent: Any  # [..., D, J] last commands, newest first
    limited: Any  # [..., J] command behind the rate limit
    seen: Any  # [..., J] reading within the play
    read: Any  # [..., D, J] last readings, newest first


class Applied(NamedTuple):
    """Values for one step of MuJoCo, [..., J] each."""

    ctrl: Any  # for the joints' actuators
    qfrc_applied: Any  # for the joints' degrees of freedom
    frictionloss: Any  # for `dof_frictionloss` of the model


@dataclass(frozen=True, slots=True)
class RuntimeEffects:
    """Effects of the joints of a patched model; a batch of parameters gives a batch of robots."""

    joints: tuple[Joint, ...]  # all J hinges and slides of the model
    parameters: Parameters
    intervals: Mapping[tuple[str, int], tuple[float, float]]  # field and joint -> 95 % interval
    step_s: float  # of the model
    depth: int  # D: steps of the longest delay, and two
    gear: Array  # [J], 1 without an actuator
    loop: NDArray[np.bool_]  # [J], whether the actuator is a position loop
    dry: Array  # [J], dry friction of the model
    back_emf: Array  # [J], damping of the model that is the motor's own

    @classmethod
    def read(cls, verdict: Path, model: Path, *, calibration: bool = True, best_fit: bool = False) -> "RuntimeEffects":
        """Return the effects of a verdict.json that its patched model cannot hold.

        Args:
            verdict: file that `softarm diagnose --json` wrote.
            model: MJCF file that `softarm diagnose --patch` wrote.
            calibration: whether calibrated parameters are included, as in the patch.
            best_fit: whether joints with a best fit have that instead, as in the patch.

        Raises:
            TrialError: the model cannot be read, lacks a joint of the verdict, or has a loop over several joints with
                an effect that acts on its error, or several actuators at a joint with a delay.
        """
        found, intervals = Verdict.model_validate_json(verdict.read_bytes()), {}
        robot = mechanism(model, found.where.share)
        joints = tuple(robot.joints.values())
        values = {name: np.full(len(joints), default, float) for name, default in Parameters._field_defaults.items()}
        sizes = {path: standard(*of) for path, of in found.findings(calibration, best_fit).items()}
        for path, size in agreed(sizes, robot).items():
            stage, _, name = path.partition(".")
            if field := _FIELDS.get(name):
                place = joints.index(robot.joint(stage))
                _refuse_common(joints[place], field, path)
                values[field][place] = size
        for effect in found.effects:
            stage, _, name = effect.name.partition(".")
            place = joints.index(robot.joint(stage))
            for parameter, known in effect.parameters.items():
                if (field := _FIELDS.get(f"{name}.{parameter}")) and not (best_fit and stage in found.best_fit):
                    intervals[field, place] = standard(known.low, known.unit), standard(known.high, known.unit)
        late_s = values["dead_time_s"]
        for place in map(int, np.flatnonzero(late_s)):  # an actuator is late for all joints that it moves
            actuator = joints[place].actuator
            for other in map(robot.joint, actuator.others if actuator else ()):
                k = joints.index(other)
                late_s[k] = late_s[place]
                if ("dead_time_s", place) in intervals:
                    intervals["dead_time_s", k] = intervals["dead_time_s", place]
        delays = [0.0, *values["dead_time_s"], *values["latency_s"]]
        delays += [high for (field, _), (_, high) in intervals.items() if field in ("dead_time_s", "latency_s")]
        depth = int(np.ceil(max(delays) / robot.step_s)) + 2
        return cls(
            joints,
            Parameters(**values),
            intervals,
            robot.step_s,
            depth,
            np.array([joint.actuator.gear if joint.actuator else 1.0 for joint in joints]),
            np.array([joint.follows for joint in joints]),
            np.array([joint.dry for joint in joints]),
            np.array([joint.viscous if joint.back_emf else 0.0 for joint in joints]),
        )

    def drawn(self, random: np.random.Generator, batch: int) -> "RuntimeEffects":
        """Return a batch of robots with sizes drawn uniformly from the 95 % intervals, [batch, J]."""
        values = {name: np.tile(getattr(self.parameters, name), (batch, 1)) for name in Parameters._fields}
        for (field, joint), (low, high) in self.intervals.items():
            if np.isfinite(low) and np.isfinite(high):
                values[field][:, joint] = random.uniform(low, high, batch)
        return replace(self, parameters=Parameters(**values))

    def start(self, ctrl: Any, position: Any, xp: Any = np) -> State:
        """Return the state at a reset, from the first commands and positions, [..., J] each."""
        reading = position + self.parameters.sensor_bias
        ctrl = xp.broadcast_to(ctrl, reading.shape)
        sent, read = (xp.repeat(x[..., None, :], self.depth, axis=-2) for x in (ctrl, reading))
        return State(sent, ctrl, reading, read)

    def apply(self, state: State, ctrl: Any, motion: Motion, xp: Any = np) -> tuple[State, Applied]:
        """Return the next state and the inputs of MuJoCo's next step.

        Args:
            state: state before the step.
            ctrl: commands of the policy, [..., J]; any number for a joint without an actuator.
            motion: motion and torques of the joints before the step.
            xp: numpy or jax.numpy.
        """
        p, gear, loop, (position, speed, torque, load) = self.parameters, self.gear, self.loop, motion
        sent = _pushed(state.sent, ctrl, xp)
        most = p.rate_per_s * self.step_s
        limited = state.limited + xp.clip(self._late(sent, p.dead_time_s, xp) - state.limited, -most, most)
        # A position loop compares the command with the reading, and MuJoCo's with the true position.
        wanted = limited + p.command_bias - xp.where(loop, gear * p.sensor_bias, 0.0)
        width = np.abs(gear) * p.deadband
        wanted = wanted - xp.where(loop, xp.clip(wanted - gear * position, -width, width), 0.0)
        motor = torque - self.back_emf * speed
        loaded = p.load_share * xp.abs(motor + p.load_part * (load - motor))
        dry = self.dry + loaded * xp.exp(-((speed / p.load_speed) ** 2))
        dry = dry + p.stiction * xp.exp(-((speed / p.stiction_speed) ** 2))
        force = p.torque_offset - p.drag * xp.abs(speed) * speed
        return state._replace(sent=sent, limited=limited), Applied(wanted, force, dry)

    def measure(self, state: State, position: Any, xp: Any = np) -> tuple[State, Any]:
        """Return the next state and the readings of the positions after a step, [..., J]."""
        p = self.parameters
        true, half = position + p.sensor_bias, 0.5 * p.backlash
        seen = xp.clip(state.seen, true - half, true + half)
        read = _pushed(state.read, seen, xp)
        return state._replace(seen=seen, read=read), self._late(read, p.latency_s, xp)

    def _late(self, last: Any, delay_s: Any, xp: Any) -> Any:
        """Return the values of a delay ago, interpolated between steps, [..., J]."""
        steps = xp.clip(delay_s / self.step_s, 0.0, self.depth - 1.001)
        steps = xp.broadcast_to(steps, last[..., 0, :].shape)[..., None, :]
        whole = xp.floor(steps).astype(int)
        newer, older = (xp.take_along_axis(last, whole + k, axis=-2)[..., 0, :] for k in (0, 1))
        return newer + (steps - whole)[..., 0, :] * (older - newer)


class Simulation:
    """One patched robot in MuJoCo with its effects, as a drop-in for `mj_step`."""

    def __init__(self, effects: RuntimeEffects, model: Any, data: Any) -> None:
        """Start at the present state of `data`; its `ctrl` holds the first commands."""
        import mujoco

        self._effects, self._model, self._data, self._step = effects, model, data, mujoco.mj_step
        self._position = np.array([joint.position for joint in effects.joints])
        self._dof = np.array([joint.dof for joint in effects.joints])
        own = (joint.actuator for joint in effects.joints)  # several actuators of a joint receive their own commands
        names = [each.name if each is not None and len(each.shares) < 2 else "" for each in own]
        first = {name: k for k, name in reversed([*enumerate(names)]) if name}  # one joint of each actuator
        self._driven = np.array([*first.values()], dtype=int)
        numbers = {model.actuator(i).name or f"actuator{i}": i for i in range(model.nu)}
        self._ctrl = np.array([numbers[name] for name in first], dtype=int)
        leads = [bool(effects.joints[k].followers) for k in self._driven]  # the actuator moves others as well
        self._leading, self._leading_ctrl = self._driven[leads], self._ctrl[leads]
        self.readings = np.zeros(len(names))  # of the joints, [J]
        self.reset()

    def reset(self) -> None:
        """Start again at the present state of `data`."""
        commands = np.zeros(len(self._effects.joints))
        commands[self._driven] = self._data.ctrl[self._ctrl]
        self._state = self._effects.start(commands, self._data.qpos[self._position])
        self.readings = self._state.read[0].copy()

    def step(self, ctrl: np.ndarray[Any, Any]) -> None:
        """Advance by one step of the model under the commands ctrl [nu]; updates `readings`."""
        data, dof, commands = self._data, self._dof, np.zeros(len(self._effects.joints))
        commands[self._driven] = ctrl[self._ctrl]
        torque = data.qfrc_actuator[dof]
        torque[self._leading] = data.actuator_force[self._leading_ctrl] * self._effects.gear[self._leading]
        motion = Motion(data.qpos[self._position], data.qvel[dof], torque, data.qfrc_bias[dof])
        self._state, applied = self._effects.apply(self._state, commands, motion)
        data.ctrl[:] = ctrl
        data.ctrl[self._ctrl] = applied.ctrl[self._driven]
        data.qfrc_applied[dof], self._model.dof_frictionloss[dof] = applied.qfrc_applied, applied.frictionloss
        self._step(self._model, data)
        self._state, self.readings = self._effects.measure(self._state, data.qpos[self._position])


def _refuse_common(joint: Joint, field: str, path: str) -> None:
    """Raise TrialError for an effect on a command that does not belong to one joint.

    That is the error of a position loop over several joints, and the delay of several actuators.
    """
    actuator, why = joint.actuator, ""
    if actuator is not None and len(actuator.shares) > 1 and field == "dead_time_s":
        why = f"{actuator.name} move {joint.name}, and this effect acts on one actuator"
    elif actuator is not None and joint.follows and actuator.others and field in _OF_LOOP:
        others = ", ".join(actuator.others)
        why = f"{actuator.name} moves {joint.name} and {others}, and this effect acts on one joint"
    if why:
        raise TrialError(
            f"{path}: {why} at run time; apply it to the command of the actuator yourself. A calibration that does not "
            "matter is left out with calibration=False"
        )


def _pushed(last: Any, newest: Any, xp: Any) -> Any:
    """Return the last values with a new one in front and without the oldest, [..., D, J]."""
    newest = xp.broadcast_to(newest, last[..., 0, :].shape)
    return xp.concatenate((newest[..., None, :], last[..., :-1, :]), axis=-2)
