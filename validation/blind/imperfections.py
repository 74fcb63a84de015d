"""Tables of the benchmark's causes with their strengths, and of the nuisances of every robot.

A cause has the name of its effect in the registry, or `unknown.NAME` without one. Its magnitude is drawn log-uniformly
between the detection limit (docs/evidence/blind.md) and strong. A cause that can occur in several forms (a lag in
filling, in venting or in both) has a variant for each.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from softarm.reality.parameters import RobotParameters

UNKNOWN = "unknown."


@dataclass(frozen=True, slots=True)
class Knob:
    """A parameter of the independent robot, `group.field`, that gets a random value."""

    path: str
    low: float
    high: float
    how: Literal["set", "add", "times"] = "set"
    either_way: bool = False  # the opposite sign, or for `times` the inverse, is equally likely
    also: str = ""  # second parameter that gets the same value
    limit: bool = False  # strong if its value is small

    @property
    def paths(self) -> tuple[str, ...]:
        """Parameters that get the value."""
        return (self.path, self.also) if self.also else (self.path,)

    def weakened(self, share: float) -> float:
        """Return the value of a cause that has this share of the weakest cause's strength."""
        if self.limit:
            return self.high / share
        return self.low**share if self.how == "times" else self.low * share

    def draw(self, random: np.random.Generator) -> float:
        """Draw a value log-uniformly between low and high, in the parameter's unit."""
        value = float(np.exp(random.uniform(np.log(self.low), np.log(self.high))))
        if self.either_way and random.random() < 0.5:
            return 1 / value if self.how == "times" else -value
        return value


Variant = tuple[Knob, ...]
_add = partial(Knob, how="add")
_limit = partial(Knob, limit=True)
_either = partial(Knob, how="add", either_way=True)
_scale = partial(Knob, how="times", either_way=True)

_FILL, _VENT = "regulator.inflate_s", "regulator.deflate_s"

# Effect -> its variants.
KNOWN: dict[str, tuple[Variant, ...]] = {
    "pressure.lag": ((_scale(_FILL, 1.2, 2.2),), (_scale(_VENT, 1.2, 2.2),), (_scale(_FILL, 1.2, 2.2, also=_VENT),)),
    "pressure.dead_time": ((Knob("regulator.dead_time_s", 0.008, 0.080),),),
    "pressure.rate_limit": ((_limit("regulator.flow_limit_kpa_s", 20.0, 45.0),),),
    "pressure.deadband": ((Knob("regulator.deadband_kpa", 0.5, 2.5),),),
    "pressure.gain": ((_either("regulator.gain", 0.04, 0.15),), (_either("regulator.offset_kpa", 0.3, 1.2),)),
    "pressure.ceiling": ((_limit("regulator.ceiling_kpa", 10.0, 17.5),),),
    "pressure.leak": ((Knob("regulator.leak_1_s", 0.15, 1.2),),),
    "pressure.sensor_bias": ((_either("pressure_sensor.bias_kpa", 0.3, 1.5),),),
    "rail.acceleration_limit": ((_limit("rail.acceleration_m_s2", 2.0, 4.2),),),
    "rail.force_limit": ((_limit("rail.force_limit_n", 1.2, 2.2),),),
    "rail.delay": ((_add("rail.delay_s", 0.012, 0.060),),),
    "rail.lag": ((Knob("rail.lag_s", 0.015, 0.080),),),
    "rail.gain": ((_either("rail.feed_error", 0.018, 0.08),),),
    "rail.coulomb_friction": ((Knob("rail.coulomb_n", 0.5, 5.0),),),
    "rail.backlash": ((Knob("rail.backlash_m", 0.0012, 0.006),),),
    "arm.stiffness": ((_either("arm.stiffness", 0.12, 0.40),),),
    "arm.damping": ((_add("arm.damping", 0.5, 1.5),),),
    "arm.muscle_gain": ((_either("arm.muscle_gain", 0.10, 0.30),),),
    "arm.torque_offset": ((_either("arm.torque_offset", 0.8, 2.0),),),
    "arm.coulomb_friction": ((Knob("arm.friction_nm", 0.002, 0.030),),),
    "arm.stiffening": ((Knob("arm.stiffening_1_rad2", 0.8, 4.5),),),
    "arm.hysteresis": ((Knob("arm.hysteresis", 0.3, 0.5), Knob("arm.hysteresis_kpa", 6.0, 12.0)),),
    "arm.muscle_saturation": ((_limit("arm.saturation_kpa", 12.0, 25.0),),),
    "arm.payload": ((Knob("arm.payload_kg", 0.007, 0.060),),),
    "arm.tilt": ((_either("arm.tilt_rad", 0.020, 0.060),),),
    "arm.drag": ((Knob("arm.air_kg_m3", 3.0, 15.0),),),
    "arm.creep": ((Knob("arm.creep", 0.15, 0.5), Knob("arm.creep_s", 1.0, 5.0)),),
    "mocap.latency": ((Knob("mocap.latency_s", 0.006, 0.050),),),
    "mocap.dropout": ((Knob("mocap.dropout", 0.05, 0.30),),),
    "mocap.rotation": ((_either("mocap.rotation_rad", 0.010, 0.050),),),
    "mocap.scale": ((_either("mocap.scale", 0.003, 0.04),),),
    "mocap.offset": ((_either("mocap.offset_y_m", 0.002, 0.020),), (_either("mocap.offset_z_m", 0.002, 0.020),)),
    "mocap.noise": ((Knob("mocap.noise_m", 0.001, 0.004),),),
    "clock.jitter": ((Knob("clock.tick_jitter_s", 0.002, 0.008),),),
    "clock.missed_ticks": ((Knob("clock.missed_ticks", 0.03, 0.15),),),
    "clock.drift": ((_either("clock.camera_drift", 0.001, 0.004),),),
}

# Parameter of the independent robot -> parameter of the registry with the same meaning; other laws have none.
SAME_SIZE = {
    _FILL: "pressure.lag.inflate",
    _VENT: "pressure.lag.deflate",
    "regulator.dead_time_s": "pressure.dead_time.delay",
    "regulator.flow_limit_kpa_s": "pressure.rate_limit.rate",
    "regulator.deadband_kpa": "pressure.deadband.width",
    "regulator.gain": "pressure.gain.scale",
    "regulator.offset_kpa": "pressure.gain.offset",
    "regulator.ceiling_kpa": "pressure.ceiling.limit",
    "regulator.leak_1_s": "pressure.leak.rate",
    "pressure_sensor.bias_kpa": "pressure.sensor_bias.bias",
    "rail.acceleration_m_s2": "rail.acceleration_limit.acceleration",
    "rail.force_limit_n": "rail.force_limit.force",
    "rail.delay_s": "rail.delay.delay",
    "rail.lag_s": "rail.lag.time",
    "rail.feed_error": "rail.gain.scale",
    "rail.coulomb_n": "rail.coulomb_friction.force",
    "rail.backlash_m": "rail.backlash.gap",
    "arm.stiffness": "arm.stiffness.scale",
    "arm.damping": "arm.damping.scale",
    "arm.muscle_gain": "arm.muscle_gain.scale",
    "arm.torque_offset": "arm.torque_offset.scale",
    "arm.payload_kg": "arm.payload.mass",
    "mocap.latency_s": "mocap.latency.delay",
    "mocap.rotation_rad": "mocap.rotation.angle",
    "mocap.scale": "mocap.scale.scale",
    "mocap.offset_y_m": "mocap.offset.y",
    "mocap.offset_z_m": "mocap.offset.z",
    "clock.camera_drift": "clock.drift.rate",
}

# Effects of the seed model that can be removed from the model file.
REMOVABLE = ("pressure.lag", "rail.acceleration_limit", "rail.delay", "observation.finite_difference")


_WOBBLE = (Knob("mocap.loose_hz", 2.5, 7.0), Knob("mocap.loose_damping", 0.05, 0.3))

# Causes outside the registry.
UNKNOWNS: dict[str, tuple[Variant, ...]] = {
    "sticking_valve": ((Knob("regulator.stick_kpa", 1.0, 3.0), Knob("regulator.stick_below_kpa", 6.0, 20.0)),),
    "random_regulator_delay": ((Knob("regulator.dead_time_jitter_s", 0.03, 0.08),),),
    "random_rail_delay": ((Knob("rail.delay_jitter_s", 0.02, 0.06),),),
    "stribeck_stiction": ((Knob("rail.stiction_n", 4.0, 9.0), Knob("rail.stribeck_m_s", 0.08, 0.25)),),
    "cable": ((Knob("rail.cable_n_m", 40.0, 150.0), _either("rail.cable_taut_m", 0.001, 0.03)),),
    "gear_ripple": ((Knob("rail.ripple_n", 2.5, 8.0), Knob("rail.ripple_period_m", 0.02, 0.06)),),
    "loose_marker": tuple((Knob("mocap.loose_link", link, link), *_WOBBLE) for link in (2, 3, 4, 5)),
    "warming_up": ((_either("arm.softening", 0.2, 0.5), Knob("arm.softening_s", 3.0, 12.0)),),
    "tiring_muscle": ((_either("arm.fatigue", 0.15, 0.4), Knob("arm.fatigue_s", 3.0, 12.0)),),
    "coarse_gauge": ((Knob("pressure_sensor.quantum_kpa", 0.8, 2.0),),),
}
_STAGE_OF_GROUP = {"regulator": "pressure", "pressure_sensor": "pressure"}  # of others, the group's own name


@dataclass(frozen=True, slots=True)
class Cause:
    """Cause of a gap: an effect of the robot, or one removed from its model file."""

    name: str  # name in the registry, or UNKNOWN + a name of UNKNOWNS
    removed: bool  # removed from the model file; the robot is unchanged
    settings: Mapping[str, float]  # parameter of the independent robot -> its value

    @property
    def stage(self) -> str:
        """Stage in which the cause acts."""
        if self.name.startswith(UNKNOWN):
            group = variants_of(self.name)[0][0].path.partition(".")[0]
            return _STAGE_OF_GROUP.get(group, group)
        return self.name.partition(".")[0]


def draw_cause(
    robot: RobotParameters, name: str, removed: bool, random: np.random.Generator
) -> tuple[RobotParameters, Cause]:
    """Return a robot with one random cause; `removed` causes leave it unchanged."""
    if removed:
        return robot, Cause(name, True, {})
    variants = variants_of(name)
    variant = variants[random.integers(len(variants))]
    values = [knob.draw(random) for knob in variant]
    robot, settings = given(robot, variant, values)
    return robot, Cause(name, False, settings)


def variants_of(name: str) -> tuple[Variant, ...]:
    """Return the variants of a cause."""
    return UNKNOWNS[name.removeprefix(UNKNOWN)] if name.startswith(UNKNOWN) else KNOWN[name]


def ranges(variant: Variant) -> str:
    """Describe the ranges from which the benchmark draws a variant."""
    sign = {"set": "", "add": "+", "times": "x "}
    both = {"set": "", "add": "±", "times": "x or / "}
    return ", ".join(
        f"`{path}` {both[knob.how] if knob.either_way else sign[knob.how]}"
        + (f"{knob.low:g}" if knob.low == knob.high else f"{knob.low:g} .. {knob.high:g}")
        for knob in variant
        for path in knob.paths
    )


def given(
    robot: RobotParameters, variant: Variant, values: Sequence[float]
) -> tuple[RobotParameters, dict[str, float]]:
    """Return a robot with one variant at these values, and the values of the changed parameters."""
    settings: dict[str, float] = {}
    for knob, value in zip(variant, values, strict=True):
        for path in knob.paths:
            robot = turned(robot, path, knob.how, value)
            settings[path] = read(robot, path)
    return robot, settings


def read(robot: RobotParameters, path: str) -> float:
    """Return a parameter of the independent robot, `group.field`."""
    group, _, name = path.partition(".")
    return float(getattr(getattr(robot, group), name))


def turned(robot: RobotParameters, path: str, how: str, value: float) -> RobotParameters:
    """Return a robot with one parameter changed; raise ValueError if the value is not allowed."""
    group, _, name = path.partition(".")
    old = getattr(getattr(robot, group), name)
    new = {"set": value, "add": old + value, "times": old * value}[how]
    if isinstance(old, int):
        new = round(new)  # number of a link
    if group == "cart":
        return replace(robot, cart=robot.cart.model_copy(update={name: new}))
    return replace(robot, **{group: replace(getattr(robot, group), **{name: new})})


# Nuisances, drawn for every case: parameter, how it is changed, and half-width of a uniform distribution.
_UNIFORM: tuple[tuple[str, Literal["add", "times"], float], ...] = (
    (_FILL, "times", 0.03),
    (_VENT, "times", 0.03),
    ("rail.acceleration_m_s2", "times", 0.03),
    ("rail.delay_s", "add", 0.002),
    ("rail.velocity_gain_n_s_m", "times", 0.05),
    ("cart.mass_kg", "times", 0.005),
    ("pressure_sensor.bias_kpa", "add", 0.05),
    ("mocap.offset_y_m", "add", 0.0005),
    ("mocap.offset_z_m", "add", 0.0005),
    ("mocap.rotation_rad", "add", 0.0005),
    ("clock.camera_drift", "add", 50e-6),
)
# Parameter of the body -> sigma, drawn once for all joints and again for each.
_BODY = {"stiffness_nm_rad": 0.015, "muscle_gain_nm_kpa": 0.015, "damping_nm_s_rad": 0.05, "torque_offset_nm": 0.05}
_MASS_HALF_WIDTH = 0.005
_SENSOR_NOISE = ("mocap.noise_m", "mocap.angle_noise_rad", "pressure_sensor.noise_kpa")


def draw_nuisances(robot: RobotParameters, random: np.random.Generator) -> RobotParameters:
    """Return a healthy robot with random deviations within tolerances."""
    body = robot.body
    update: dict[str, tuple[float, ...]] = {
        name: _scaled(getattr(body, name), 1 + random.normal(0, sigma) + random.normal(0, sigma, body.links))
        for name, sigma in _BODY.items()
    }
    masses = 1 + random.uniform(-_MASS_HALF_WIDTH, _MASS_HALF_WIDTH, body.links)
    update["link_mass_kg"] = _scaled(body.link_mass_kg, masses)
    robot = replace(robot, body=body.model_copy(update=update))
    for path, how, half in _UNIFORM:
        off = random.uniform(-half, half)
        robot = turned(robot, path, how, off if how == "add" else 1 + off)
    for path in _SENSOR_NOISE:
        robot = turned(robot, path, "times", float(np.exp(random.uniform(np.log(0.7), np.log(1.4)))))
    for path, low, high in (
        ("clock.tick_jitter_s", 0.0001, 0.0003),
        ("mocap.dropout", 0.001, 0.005),
        ("regulator.tube_s", 0.003, 0.008),
        ("mocap.transport_s", 0.002, 0.006),
        ("mocap.transport_jitter_s", 0.0002, 0.0008),
    ):
        robot = turned(robot, path, "set", random.uniform(low, high))
    return robot


def _scaled(values: Iterable[float], factors: Iterable[float]) -> tuple[float, ...]:
    return tuple(float(value * factor) for value, factor in zip(values, factors, strict=True))
