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
    layout.TILT: {"slope": 0.0},
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
    bad = [float(number) for number in (array.min(), array.max()) if not parameter.admits(number)]
    if bad:
        raise EffectError(out_of_range(effect, parameter, bad[0]))
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


def needed(packed: Array, links: int) -> int:
    """Return the bits of the kernel's parts that parameters [R, parameter] need."""
    at, bits = kernel.rows((0,) * links), 0
    for bit, neutral in _NEEDED_BY.items():
        if any((packed[:, getattr(at, name)] != idle).any() for name, idle in neutral.items()):
            bits |= bit
    return bits


def _each(arms: Sequence[Arm] | Sequence[Cart], name: str) -> Array:
    return np.array([getattr(arm, name) for arm in arms], dtype=np.float64)


def _arm(arms: Sequence[Arm], carts: Sequence[Cart], effects: Effects) -> dict[str, Array]:
    """Return the rows of links and joints with the arm's effects; [R], [R, n] or [R, n, n]."""
    length, mass = _each(arms, "link_length_m"), _each(arms, "link_mass_kg")
    n, payload = length.shape[1], effects.value("arm.payload", "mass")
    beyond = np.cumsum(mass[:, ::-1], axis=1)[:, ::-1] - mass + payload[:, None]  # mass beyond each link
    moment = length * (mass / 2 + beyond)
    coupling = moment[:, :, None] * length[:, None, :]  # l_j S_i, right where i > j
    diagonal = _each(arms, "link_inertia_kg_m2") + length**2 * (mass / 4 + beyond)
    coupling[:, range(n), range(n)] = diagonal
    gravity, tilt = _each(arms, "gravity_m_s2"), effects.value("arm.tilt", "angle")
    cart_mass = _each(carts, "mass_kg")
    total = cart_mass + mass.sum(axis=1) + payload

    def scaled(name: str, effect: str) -> Array:
        return _each(arms, name) * (1.0 + effects.value(effect, "scale"))[:, None]

    loop = effects.value("arm.hysteresis", "strength") * effects.value("arm.hysteresis", "width")
    return {
        "mass": total,
        "cart_mass": cart_mass,
        "base_height": _each(arms, "base_height_m"),
        "length": length,
        "moment": moment,
        "weight": (gravity * np.cos(tilt))[:, None] * moment,
        "stiffness": scaled("stiffness_nm_rad", "arm.stiffness"),
        "damping": scaled("damping_nm_s_rad", "arm.damping"),
        "muscle": scaled("muscle_gain_nm_kpa", "arm.muscle_gain"),
        "offset": scaled("torque_offset_nm", "arm.torque_offset"),
        "coupling": coupling,
        "muscle_loop": loop,
        "muscle_width": 1.0 / effects.value("arm.hysteresis", "width"),
        "saturation": 1.0 / effects.value("arm.muscle_saturation", "pressure"),
        "cubic": effects.value("arm.stiffening", "cubic"),
        "joint_friction": effects.value("arm.coulomb_friction", "torque"),
        "creep": effects.value("arm.creep", "strength"),
        "creep_time": effects.value("arm.creep", "time"),
        "payload": payload,
        "payload_weight": payload * gravity,
        "drag": effects.value("arm.drag", "coefficient"),
        "drag_most": 0.5 * mass,
        "slope": np.tan(tilt),
        "downhill": total * gravity * np.sin(tilt),
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
