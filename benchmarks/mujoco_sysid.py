"""Baseline of `benchmarks.diagnosis`: mujoco.sysid fits the arm and the regulator to recordings of the robot.

Both are fitted as its documentation shows: an MjSpec (the robot as `softarm model export` writes it), parameters
within bounds, per-sensor delays, whole trajectories, its default optimiser, stopped when the objective no longer
improves. The inputs are those of the diagnosis's stages: measured pressure and cart for the arm, commands for the
regulator. Needs mujoco[sysid].
"""

import contextlib
import io
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from mujoco import sysid
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from softarm.diagnosis.robot.trial_grid import RATE_HZ, SKIPPED_S, TrialGrid
from softarm.diagnosis.robot.views import directions
from softarm.schemas.model import Model
from softarm.simulator.mjcf import export

Array = NDArray[np.float64]
Build = Callable[[Any, Any], Any]  # (ParameterDict, MjSpec) -> MjModel

Bounds = tuple[float, float, float]  # start, low, high

STEP_HZ = 480.0  # of MuJoCo in every fit; `step_error_m` returns its error
CART_KG, CART_RAD_S = 1000.0, 120.0  # a cart that follows its measured path regardless of the arm
DELAY_MAX_S = 0.15
# A fit ends when an iteration improves the objective by less than SETTLED, or after REFUSED_MAX refused candidates.
# The optimiser's own criteria lie below the noise of its finite differences.
SETTLED, REFUSED_MAX = 1e-4, 60
ARM_BOUNDS: Mapping[str, Bounds] = {
    "stiffness": (1.0, 0.3, 3.0),  # relative to the model, equal for all joints, as the next three
    "damping": (1.0, 0.2, 5.0),
    "muscle_gain": (1.0, 0.3, 3.0),
    "torque_offset": (1.0, -1.0, 5.0),
    "payload": (0.0, 0.0, 0.5),  # kg
    "friction": (0.0, 0.0, 0.2),  # N m, every joint
    "tilt": (0.0, -0.2, 0.2),  # rad
    "delay": (0.0, -0.02, DELAY_MAX_S),  # s, of the cameras
}


def is_installed() -> bool:
    """Return whether the extra is installed; without it `mujoco.sysid` imports as an empty package."""
    return hasattr(sysid, "optimize")


@dataclass(frozen=True, slots=True)
class Recorded:
    """One trial in the toolbox's format: seconds from its start, inputs, measurements."""

    control_t_s: Array  # [C]
    control: Array  # [C, U]
    angles_rad: Array  # [n] joints at the start; empty for the regulator
    first_kpa: float
    t_s: Array  # [N] of the samples compared
    measured: Array  # [N, S]


@dataclass(frozen=True, slots=True)
class Fitted:
    """Fitted parameters and the work of the fit."""

    values: Mapping[str, float]
    iterations: int
    simulations: int  # of all trials


class _SettledError(Exception):
    """Signal that the objective no longer improves."""


class _Watch:
    """Residual function of a fit that keeps the best result and ends the fit by SETTLED and REFUSED_MAX."""

    def __init__(self, residual: Callable[..., Any]) -> None:
        self._residual, self._least, self._refused = residual, math.inf, 0
        self.best: Array | None = None
        self.iterations = self.simulations = 0

    def __call__(self, x: Array, parameters: Any) -> Any:
        """Return the residuals at one x or at several, one column each, or raise _SettledError."""
        found = self._residual(x, parameters)
        columns = x.reshape(len(x), -1)
        self.simulations += columns.shape[1]
        if columns.shape[1] > 1:  # a Jacobian's
            return found
        objective = sum(float(np.sum(np.square(each))) for each in found[0])
        self._refused += 1
        if objective < self._least:
            self._least, self.best, self._refused = objective, columns[:, 0].copy(), 0
        if self._refused == REFUSED_MAX:
            raise _SettledError
        return found

    def ended(self, trace: Sequence[Any]) -> None:
        """Check the progress after an iteration and raise _SettledError when it is settled."""
        self.iterations = len(trace)
        if float(trace[-1].reduction) < SETTLED * float(trace[-1].objective):
            raise _SettledError


class SysidStage:
    """Part of the robot that is fitted separately."""

    name, unit = "", ""
    bounds: Mapping[str, Bounds]

    def __init__(self, model: Model) -> None:
        self.model = model
        self.spec = self._spec(STEP_HZ)

    def recorded(self, grid: TrialGrid, trial: int) -> Recorded | None:
        """Return a trial of a flight, or None if it measured no signal of this stage."""
        raise NotImplementedError

    def fit(self, trials: Sequence[Recorded]) -> Fitted:
        """Fit whole trajectories by least squares in the unit of the stage, from the nominal model."""
        parameters = sysid.ParameterDict(
            {name: sysid.Parameter(name, *bounds) for name, bounds in self.bounds.items()}
        ).move_off_bounds(fraction=0.01)  # the toolbox's advice for parameters that start at their bounds
        transform = sysid.SignalTransform(normalize=False)  # so that the residual is the compared quantity
        transform.delay("*", parameters["delay"])
        compiled = self.spec.compile()
        # All sensors are named, since version 4.0.0 fails on sensors with three values otherwise.
        transform.enable_sensors([compiled.sensor(i).name for i in range(compiled.nsensor)])
        sequences = sysid.ModelSequences(
            self.name,
            self.spec,
            [f"trial-{i}" for i in range(len(trials))],
            [self._start(compiled, each) for each in trials],
            [_series(each.control_t_s, each.control) for each in trials],
            [_series(each.t_s, self._sensors(each.measured), compiled) for each in trials],
        )
        residual = sysid.build_residual_fn(
            models_sequences=[sequences], build_model=self._build, modify_residual=transform.apply
        )
        watch = _Watch(residual)
        # The only way to silence its iterations.
        with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(_SettledError):
            sysid.optimize(parameters, watch, verbose=False, iter_callback=watch.ended)
        parameters.update_from_vector(watch.best)
        values = {name: float(parameters[name].value[0]) for name in self.bounds}
        return Fitted(values, watch.iterations, watch.simulations)

    def nominal(self) -> dict[str, float]:
        """Return the parameters before any fit."""
        return {name: start for name, (start, _, _) in self.bounds.items()}

    def predict(self, values: Mapping[str, float], trial: Recorded, step_hz: float = STEP_HZ) -> Array:
        """Return the simulated sensors of a trial, [N, S]."""
        spec = self.spec if step_hz == STEP_HZ else self._spec(step_hz)
        parameters = sysid.ParameterDict({n: sysid.Parameter(n, x, x - 1, x + 1) for n, x in values.items()})
        model = self._build(parameters, spec)
        control = _series(trial.control_t_s, trial.control).resample(target_dt=1 / step_hz)
        start = self._start(model, trial)
        seen = sysid.sysid_rollout([model], [mujoco.MjData(model)], [control], [start])[0].sensordata
        return self._channels(seen.resample(trial.t_s - values["delay"]).data)

    def _spec(self, step_hz: float) -> Any:
        raise NotImplementedError

    def _build(self, parameters: Any, spec: Any) -> Any:
        """Write the parameters into the spec, starting from the nominal model, and compile it."""
        raise NotImplementedError

    def _start(self, model: Any, trial: Recorded) -> Array:
        raise NotImplementedError

    def _sensors(self, measured: Array) -> Array:
        return measured

    def _channels(self, sensors: Array) -> Array:
        return sensors


class SysidArm(SysidStage):
    """Stage from measured pressure and cart to the link ends relative to the cart."""

    name, unit = "arm", "m"

    def __init__(self, model: Model) -> None:
        super().__init__(model)
        self.bounds = ARM_BOUNDS

    def recorded(self, grid: TrialGrid, trial: int) -> Recorded | None:
        """Return the arm's inputs and measurements of a trial."""
        t, rows = _grid(grid, trial)
        pressure, links = grid.pressure_kpa[rows, trial], grid.links_m[rows, trial]
        seen = np.isfinite(links).all(axis=1) & np.isfinite(pressure) & (t >= SKIPPED_S)
        if not seen.any():
            return None
        way = CubicHermiteSpline(t, grid.hinge_m[rows, trial], grid.hinge_m_s[rows, trial])
        fine = np.arange(int(t[-1] * STEP_HZ) + 1) / STEP_HZ
        control = np.stack((way(fine, 1), np.interp(fine, t, np.nan_to_num(pressure)), way(fine)), axis=1)
        joints = np.diff(directions(grid)[trial], prepend=0.0)
        return Recorded(fine, control, joints, float(control[0, 1]), t[seen], links[seen])

    def _spec(self, step_hz: float) -> Any:
        spec = mujoco.MjSpec.from_string(export(self.model).xml)
        spec.option.timestep = 1 / step_hz
        for sensor in list(spec.sensors):
            spec.delete(sensor)
        _lead_cart(spec)
        muscle = spec.actuator("pressure")
        muscle.dyntype, muscle.dynprm[0] = mujoco.mjtDyn.mjDYN_NONE, 1.0
        muscle.gainprm[0], muscle.biasprm[0], muscle.ctrllimited = 1.0, 0.0, False
        for i, length in enumerate(self.model.arm.link_length_m, 1):
            link = spec.body(f"link{i}")
            link.add_site(name=f"end{i}", pos=(0.0, 0.0, -length))
            spec.add_sensor(
                name=f"link{i}",
                type=mujoco.mjtSensor.mjSENS_FRAMEPOS,
                objtype=mujoco.mjtObj.mjOBJ_SITE,
                objname=f"end{i}",
                reftype=mujoco.mjtObj.mjOBJ_XBODY,
                refname="cart",
            )
        if not any(body.name == "payload" for body in spec.bodies):
            load = link.add_body(name="payload", pos=(0.0, 0.0, -length))
            load.explicitinertial, load.mass, load.inertia = True, 1e-9, (1e-9, 1e-9, 1e-9)
            load.ipos = (0.0, 0.0, 0.0)  # otherwise the offset of the body counts twice
        return spec

    def _build(self, parameters: Any, spec: Any) -> Any:
        arm = self.model.arm
        at = {name: float(parameters[name].value[0]) for name in self.bounds}
        rows = zip(arm.stiffness_nm_rad, arm.damping_nm_s_rad, arm.torque_offset_nm, strict=True)
        for i, (stiffness, damping, offset) in enumerate(rows, 1):
            joint = spec.joint(f"joint{i}")
            joint.stiffness[0], joint.damping[0] = at["stiffness"] * stiffness, at["damping"] * damping
            joint.springref = -at["torque_offset"] * offset / (at["stiffness"] * stiffness)
            joint.frictionloss = at["friction"]
        spec.actuator("pressure").gear[0] = at["muscle_gain"]
        spec.body("payload").mass = max(at["payload"], 1e-9)
        down = arm.gravity_m_s2
        spec.option.gravity = (-down * math.sin(at["tilt"]), 0.0, -down * math.cos(at["tilt"]))
        return spec.compile()

    def _start(self, model: Any, trial: Recorded) -> Array:
        speed, _, place = trial.control[0]
        position, velocity = np.array([place, *trial.angles_rad]), np.zeros(model.nv)
        velocity[0] = speed
        return np.asarray(sysid.create_initial_state(model, position, velocity))

    def _sensors(self, measured: Array) -> Array:
        y, z = np.split(measured, 2, axis=1)
        return np.stack((y, np.zeros_like(y), z), axis=2).reshape(len(y), -1)

    def _channels(self, sensors: Array) -> Array:
        return np.concatenate((sensors[:, 0::3], sensors[:, 2::3]), axis=1)


class SysidPressure(SysidStage):
    """Stage from the command to the regulator's reading: a lag as MJCF has it, gain, offset and sensor delay."""

    name, unit = "pressure", "kPa"

    def __init__(self, model: Model) -> None:
        super().__init__(model)
        lag = float(self.spec.actuator("pressure").dynprm[0])
        self.bounds = {
            "lag": (lag, 0.002, 2.0),  # s, equal for rise and fall
            "gain": (1.0, 0.5, 1.5),
            "offset": (0.0, -5.0, 5.0),  # kPa
            "delay": (0.0, -0.02, 0.3),  # s
        }

    def recorded(self, grid: TrialGrid, trial: int) -> Recorded | None:
        """Return the regulator's commands and readings of a trial."""
        t, rows = _grid(grid, trial)
        pressure = grid.pressure_kpa[rows, trial]
        seen = np.isfinite(pressure) & (t >= SKIPPED_S)
        if not seen.any():
            return None
        fine = np.arange(int(t[-1] * STEP_HZ) + 1) / STEP_HZ
        came = np.maximum.accumulate(t + grid.late_s[rows, trial])
        held = grid.pressure_command_kpa[rows, trial][np.maximum(np.searchsorted(came, fine, side="right") - 1, 0)]
        return Recorded(fine, held[:, None], np.zeros(0), float(pressure[seen][0]), t[seen], pressure[seen][:, None])

    def _spec(self, step_hz: float) -> Any:
        """Return the exported actuator on a separate slider, since the arm does not affect the regulator."""
        given = mujoco.MjSpec.from_string(export(self.model).xml).actuator("pressure")
        spec = mujoco.MjSpec.from_string(
            '<mujoco><worldbody><body><joint name="slider" type="slide" damping="1"/>'
            '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody><actuator>'
            '<general name="pressure" joint="slider" biastype="affine"/></actuator>'
            '<sensor><actuatorfrc name="pressure" actuator="pressure"/></sensor></mujoco>'
        )
        spec.option.timestep, spec.option.gravity = 1 / step_hz, (0.0, 0.0, 0.0)
        own = spec.actuator("pressure")
        own.dyntype, own.dynprm[0] = mujoco.mjtDyn.mjDYN_FILTEREXACT, max(float(given.dynprm[0]), 0.002)
        return spec

    def _build(self, parameters: Any, spec: Any) -> Any:
        own = spec.actuator("pressure")
        own.dynprm[0], own.gainprm[0], own.biasprm[0] = (
            float(parameters[name].value[0]) for name in ("lag", "gain", "offset")
        )
        return spec.compile()

    def _start(self, model: Any, trial: Recorded) -> Array:
        return np.asarray(sysid.create_initial_state(model, np.zeros(1), np.zeros(1), np.array([trial.first_kpa])))


FITTED: tuple[type[SysidStage], ...] = (SysidPressure, SysidArm)


def step_error_m(model: Model, trials: Sequence[Recorded]) -> float:
    """Return the RMS error of the link ends from MuJoCo's step, relative to an eighth of it."""
    stage = SysidArm(model)
    pairs = [(stage.predict(stage.nominal(), t), stage.predict(stage.nominal(), t, 8 * STEP_HZ)) for t in trials]
    return float(np.sqrt(np.concatenate([(a - b).ravel() ** 2 for a, b in pairs]).mean()))


def every_recorded(stage: SysidStage, grid: TrialGrid) -> Iterator[tuple[int, Recorded]]:
    """Yield the trials of a flight that show a stage, with their numbers."""
    for trial in range(len(grid.trials)):
        if (found := stage.recorded(grid, trial)) is not None:
            yield trial, found


def _lead_cart(spec: Any) -> None:
    """Move the cart along its measured path by a servo; controls: velocity, pressure, position."""
    cart, joint, speed = spec.body("cart"), spec.joint("cart"), spec.actuator("cart_velocity")
    cart.mass, joint.limited = CART_KG, False
    joint.damping[0], joint.frictionloss = 0.0, 0.0
    stiff, damped = CART_KG * CART_RAD_S**2, 2 * CART_KG * CART_RAD_S
    speed.dyntype, speed.dynprm[0], speed.ctrllimited = mujoco.mjtDyn.mjDYN_NONE, 1.0, False
    # The exported actuator takes the velocity, an additional one the position.
    speed.gainprm[0], speed.biasprm[2] = damped, -damped
    place = spec.add_actuator(name="cart_position", target="cart", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    place.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    place.gainprm[0], place.biasprm[1] = stiff, -stiff


def _grid(grid: TrialGrid, trial: int) -> tuple[Array, slice]:
    steps = int(grid.steps[trial])
    return np.arange(steps) / RATE_HZ, slice(0, steps)


def _series(t_s: Array, data: Array, model: Any = None) -> Any:
    mapping = None if model is None else sysid.TimeSeries.compute_all_sensor_mapping(model)
    return sysid.TimeSeries(t_s, data, mapping)
