"""Conversion of models and values of effects to the kernel's parameters."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softarm.schemas.model import Arm, Cart, Model
from softarm.simulator import kernel
from softarm.simulator.effects import EffectError, find, out_of_range, validate, value
from softarm.simulator.kernel import contact, layout

Array = NDArray[np.float64]

# The rail's end stops, which are not published: a cart at 1 m/s overruns by about 1 mm and does not bounce.
STOP_STIFFNESS_N_M = 2e5
STOP_DAMPING_N_S_M = 600.0
# Stands for infinity: the switch of the tracker (m/s) and the ramp (m/s^2) without rail.acceleration_limit.
NEVER = 1e30

# Substeps at lower rates may diverge under hard commands.
RATE_MIN_HZ = 120.0
# A joint whose damping is at least this share of stiffness times substep keeps every mode stable.
UNDAMPED = 0.7
# A mode that turns by less in a substep is stable without damping, rad.
RESOLVED_RAD = 3.0

# Neutral values of each part's rows: a batch needs the part if any robot's row differs.
_NEEDED_BY = {
    layout.PRESSURE: {
        "dead_time": 0.0,
        "deadband": 0.0,
        "pressure_gain": 1.0,
        "pressure_offset": 0.0,
        "ceiling": np.inf,
        "pressure_rate": np.inf,
        "leak": 0.0,
    },
    layout.RAIL: {
        "servo": 0.0,
        "rail_gain": 1.0,
        "rail_lag": 0.0,
        "cart_friction": 0.0,
        "cart_viscous": 0.0,
        "backlash": 0.0,
        "force_limit": np.inf,
    },
    layout.JOINTS: {"cubic": 0.0, "joint_friction": 0.0, "creep": 0.0},
    layout.MUSCLE: {"muscle_loop": 0.0, "saturation": 0.0},
    layout.AIR: {"drag": 0.0},
    layout.PAYLOAD: {"payload": 0.0},
}


class Effects:
    """Values of the effects of a batch, by name."""

    def __init__(self, models: Sequence[Model], overrides: Mapping[str, ArrayLike], robots: int) -> None:
        """Check models and overrides ('stage.effect.parameter' -> scalar or [R]); raise EffectError if invalid."""
        for model in models:
            validate(model.effects)
        self._models = models
        self._overrides = {path: _checked(path, values, robots) for path, values in overrides.items()}

    def value(self, effect: str, parameter: str) -> Array:
        """Return the values in the parameter's unit, [R], or [1] if they are the same for all robots."""
        path = f"{effect}.{parameter}"
        if path in self._overrides:
            return self._overrides[path]
        return np.array([value(model, effect, parameter) for model in self._models])

    def present(self, effect: str) -> Array:
        """Return 1 where a model has the effect and 0 elsewhere, [R] or [1]; for effects without parameters."""
        return np.array([float(effect in model.effects) for model in self._models])


def _checked(path: str, values: ArrayLike, robots: int) -> Array:
    effect, parameter = find(path)
    array = np.atleast_1d(np.asarray(values, dtype=np.float64))
    if array.shape not in ((1,), (robots,)):
        raise ValueError(f"{path} has shape {array.shape}; give a scalar or one entry a robot, ({robots},)")
    bad = array[~(((array >= parameter.low) & (array <= parameter.high)) | (array == parameter.also))]
    if bad.size:
        raise EffectError(out_of_range(effect, parameter, float(bad[0])))
    return array


def pack(models: Sequence[Model], effects: Effects) -> Array:
    """Return the kernel's parameters in the order of `kernel.rows`, [R, parameter], or [1, parameter] if all are alike.

    An absent effect has its neutral value: no lag, no delay, and the velocity tracker at any error instead of the
    acceleration tracker.
    """
    arms, carts = [model.arm for model in models], [model.cart for model in models]
    columns = _arm(arms, carts, effects) | _actuators(carts, effects) | _shelf(arms, effects)
    robots = np.broadcast_shapes(*(values.shape[:1] for values in columns.values()))[0]
    at = kernel.rows((0,) * arms[0].links)
    packed = np.zeros((robots, at.shelf_y))
    for name, values in columns.items():
        first = getattr(at, name)
        flat = values.reshape(len(values), -1)
        packed[:, first : first + flat.shape[1]] = flat
    return packed


def needed(packed: NDArray[np.floating], links: int) -> int:
    """Return the bits of the kernel's parts that parameters [R, parameter] need."""
    at, bits = kernel.rows((0,) * links), 0
    for bit, neutral in _NEEDED_BY.items():
        if any((packed[:, getattr(at, name)] != idle).any() for name, idle in neutral.items()):
            bits |= bit
    return bits


def rate_needed_hz(packed: NDArray[np.floating], links: int) -> float:
    """Return the lowest rate of substeps at which no robot's stiff modes gain energy, Hz.

    Centrifugal forces are extrapolated. They feed a mode that the substep does not resolve, unless the joints' damping
    consumes more. Both bounds were measured over the registry's ranges of stiffness and damping.

    Args:
        packed: parameters [R, parameter].
        links: number of links.
    """
    at = kernel.rows((0,) * links)
    length, moment, inertia, stiffness, damping = (
        packed[:, first : first + links].astype(np.float64)
        for first in (at.length, at.moment, at.inertia, at.stiffness, at.damping)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        damped = UNDAMPED * np.where(stiffness > 0.0, stiffness / damping, 0.0).max(axis=1)
    light = damped > RATE_MIN_HZ
    if not light.any():
        return 0.0
    mass = np.tril(moment[light, :, None] * length[light, None, :], -1)
    mass += mass.transpose(0, 2, 1) + inertia[light, :, None] * np.eye(links)
    bend = np.eye(links) - np.eye(links, k=-1)
    squares = np.linalg.eigvals(np.linalg.solve(mass, bend.T @ (stiffness[light, :, None] * bend)))
    resolved = np.sqrt(squares.real.max(axis=1)) / RESOLVED_RAD
    return float(np.minimum(damped[light], resolved).max())


def _each(arms: Sequence[Arm] | Sequence[Cart], name: str) -> Array:
    return np.array([getattr(arm, name) for arm in arms], dtype=np.float64)


def _arm(arms: Sequence[Arm], carts: Sequence[Cart], effects: Effects) -> dict[str, Array]:
    """Return the rows of links and joints with the arm's effects; [R] or [R, n]."""
    length, mass = _each(arms, "link_length_m"), _each(arms, "link_mass_kg")
    payload = effects.value("arm.payload", "mass")
    beyond = np.cumsum(mass[:, ::-1], axis=1)[:, ::-1] - mass + payload[:, None]  # mass beyond each link
    moment = length * (mass / 2 + beyond)
    gravity, tilt = _each(arms, "gravity_m_s2"), effects.value("arm.tilt", "angle")
    cart_mass = _each(carts, "mass_kg")

    def scaled(name: str, effect: str) -> Array:
        return _each(arms, name) * (1.0 + effects.value(effect, "scale"))[:, None]

    loop = effects.value("arm.hysteresis", "strength") * effects.value("arm.hysteresis", "width")
    return {
        "mass": cart_mass + mass.sum(axis=1) + payload,
        "cart_mass": cart_mass,
        "base_height": _each(arms, "base_height_m"),
        "length": length,
        "moment": moment,
        "stiffness": scaled("stiffness_nm_rad", "arm.stiffness"),
        "damping": scaled("damping_nm_s_rad", "arm.damping"),
        "muscle": scaled("muscle_gain_nm_kpa", "arm.muscle_gain"),
        "offset": scaled("torque_offset_nm", "arm.torque_offset"),
        "inertia": _each(arms, "link_inertia_kg_m2") + length**2 * (mass / 4 + beyond),
        "gravity": gravity * np.cos(tilt),
        "gravity_along": gravity * np.sin(tilt),
        "muscle_loop": loop,
        "muscle_width": 1.0 / effects.value("arm.hysteresis", "width"),
        "saturation": 1.0 / effects.value("arm.muscle_saturation", "pressure"),
        "cubic": effects.value("arm.stiffening", "cubic"),
        "joint_friction": effects.value("arm.coulomb_friction", "torque"),
        "creep": effects.value("arm.creep", "strength"),
        "creep_time": effects.value("arm.creep", "time"),
        "payload": payload,
        "drag": effects.value("arm.drag", "coefficient"),
        "drag_most": 0.5 * mass,
    }


def _actuators(carts: Sequence[Cart], effects: Effects) -> dict[str, Array]:
    acceleration = effects.value("rail.acceleration_limit", "acceleration")
    limited = np.isfinite(acceleration)
    gain = _each(carts, "acceleration_gain_kg")
    pushed = _each(carts, "feedforward_mass_kg") + gain
    return {
        "drive_force": pushed * np.where(limited, acceleration, 0.0),
        "drive_inertia": np.where(limited, gain, 0.0),
        "switch": np.where(limited, _each(carts, "tracking_switch_m_s"), NEVER),
        "servo": effects.present("rail.servo"),
        "ramp": np.minimum(acceleration, NEVER),
        "feedforward": _each(carts, "feedforward_mass_kg"),
        "velocity_gain": _each(carts, "velocity_gain_n_s_m"),
        "travel": _each(carts, "travel_m"),
        "stop_stiffness": np.array([STOP_STIFFNESS_N_M]),
        "stop_damping": np.array([STOP_DAMPING_N_S_M]),
        "rail_delay": effects.value("rail.delay", "delay"),
        "rail_gain": 1.0 + effects.value("rail.gain", "scale"),
        "rail_lag": effects.value("rail.lag", "time"),
        "cart_friction": effects.value("rail.coulomb_friction", "force"),
        "cart_viscous": effects.value("rail.coulomb_friction", "viscous"),
        "backlash": effects.value("rail.backlash", "gap"),
        "force_limit": effects.value("rail.force_limit", "force"),
        "dead_time": effects.value("pressure.dead_time", "delay"),
        "deadband": effects.value("pressure.deadband", "width"),
        "pressure_gain": 1.0 + effects.value("pressure.gain", "scale"),
        "pressure_offset": effects.value("pressure.gain", "offset"),
        "ceiling": effects.value("pressure.ceiling", "limit"),
        "inflate": effects.value("pressure.lag", "inflate"),
        "deflate": effects.value("pressure.lag", "deflate"),
        "pressure_rate": effects.value("pressure.rate_limit", "rate"),
        "leak": effects.value("pressure.leak", "rate"),
    }


def _shelf(arms: Sequence[Arm], effects: Effects) -> dict[str, Array]:
    span = _each(arms, "link_length_m")
    span[:, -1] = np.maximum(span[:, -1] - contact.RADIUS_M, 0.0)  # the round end lies within the last link
    return {
        "span": span,
        "shelf_friction": effects.value("contact.friction", "coefficient"),
        "shelf_stiffness": effects.value("contact.stiffness", "stiffness"),
    }
