"""The effects of single-stage tables: the registry's, under the table's own name, and what such a rig has beyond them.

`servo1.deadband` is `pressure.deadband` for a thing whose unit is rad; meaning and source come from the registry.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from softarm.schemas.trial import StageKind
from softarm.simulator.effect_table import shape
from softarm.simulator.effects import REGISTRY, Effect, Parameter
from softarm.simulator.kernel.joints import REACH_RAD

__all__ = ["Effect", "Parameter", "effects"]


@dataclass(frozen=True, slots=True)
class _Use:
    """A registry effect on a rig: how its parameters are called there, and which of them a rig does not have."""

    origin: str
    names: Mapping[str, str]  # registry parameter -> here
    neutral: Mapping[str, float] = field(default_factory=dict)  # where the rig's differs
    meaning: str = ""  # where the rig's law differs


# What a follower of commands can do wrong, in the order in which a command meets it.
_TRACKING: dict[str, _Use] = {
    "dead_time": _Use("pressure.dead_time", {"delay": "delay"}),
    "gain": _Use(
        "pressure.gain",
        {"scale": "scale", "offset": "offset"},
        meaning="it ends at command x (1 + scale) + offset: a proportional loop droops under a load",
    ),
    "deadband": _Use(
        "pressure.deadband",
        {"width": "width"},
        meaning="an error up to the width, either way, moves nothing: dry friction against a proportional loop",
    ),
    "lag": _Use("rail.lag", {"time": "time"}, meaning="it follows the command as a first-order lag"),
    "rate_limit": _Use("pressure.rate_limit", {"rate": "rate"}, meaning="it moves no faster than this"),
    "acceleration_limit": _Use(
        "rail.acceleration_limit",
        {"acceleration": "acceleration"},
        meaning="its velocity changes no faster than this: a motor's torque has an end",
    ),
    "backlash": _Use("rail.backlash", {"gap": "gap"}),
}
_PENDULUM: dict[str, _Use] = {
    "stiffness": _Use("arm.stiffness", {"scale": "scale"}, meaning="mis-fit moment of the weight: m g a x (1 + scale)"),
    # The model has viscous friction; a joint may have none. So the neutral value is none, and nominal is 0.
    "damping": _Use("arm.damping", {"scale": "scale"}, {"scale": -1.0}),
    "coulomb_friction": _Use("arm.coulomb_friction", {"torque": "torque"}),
    "stiffening": _Use(
        "arm.stiffening", {"cubic": "cubic"}, meaning="the moment grows with the angle: x (1 + cubic angle^2)"
    ),
    "drag": _Use("arm.drag", {"coefficient": "coefficient"}),
    "sensor_bias": _Use(
        "pressure.sensor_bias", {"bias": "bias"}, meaning="the encoder's zero is off, or the base leans"
    ),
}
_KINDS: dict[str, dict[str, _Use]] = {"tracking": _TRACKING, "pendulum": _PENDULUM}

# Bounds and usual changes (low, high, usual) of parameters whose unit the registry's rig does not share, by the unit of
# what is measured: a servo turns by a radian where a regulator has 20 kPa and an axis a quarter of a metre.
_SPANS: dict[tuple[str, str], tuple[float, float, float]] = {
    ("rad", "offset"): (-0.5, 0.5, 0.03),
    ("rad", "width"): (0.0, 0.3, 0.02),
    ("rad", "rate"): (0.05, 100.0, 1.5),
    ("rad", "acceleration"): (0.5, 1000.0, 20.0),
    ("rad", "gap"): (0.0, 0.3, 0.02),
    ("rad", "bias"): (-0.2, 0.2, 0.005),
    ("m", "offset"): (-0.1, 0.1, 0.005),
    ("m", "width"): (0.0, 0.05, 0.002),
    ("m", "rate"): (0.01, 20.0, 0.5),
    ("m/s", "offset"): (-0.2, 0.2, 0.02),
    ("m/s", "width"): (0.0, 0.2, 0.01),
    ("m/s", "rate"): (0.1, 100.0, 4.0),
    ("m/s", "acceleration"): (1.0, 10000.0, 100.0),
    ("kPa", "acceleration"): (10.0, 100000.0, 1000.0),
    ("kPa", "gap"): (0.0, 5.0, 0.5),
}
# Beyond the registry: how far a joint turns before its dry friction is whole. The simulator's kernel has it fixed.
_GIVE = shape("give", "rad", REACH_RAD, REACH_RAD, 0.05, 5e-3, "turn after which the friction has its full value")
# Of a pendulum's weight's moment: what dry friction must take to be noticed.
_NOTICED_SHARE = 0.003

# Pairs easily taken for each other on a rig, and what tells them apart; beside what the registry says.
_RIVALS: tuple[tuple[str, str, str], ...] = (
    ("deadband", "backlash", "reversals under load: play shuts, a friction's dead zone stays"),
    ("deadband", "lag", "a slow ramp: a lag's error shrinks with its slope, a dead zone's stays"),
    (
        "rate_limit",
        "acceleration_limit",
        "fast sines of two sizes: a rate limit makes triangles, the other turns over late",
    ),
    ("rate_limit", "lag", "steps of several sizes: the time grows with the step only for a limit"),
    ("acceleration_limit", "lag", "sines of two sizes: only a limit answers the larger one less"),
    ("coulomb_friction", "drag", "an amplitude sweep: dry friction rules small swings, drag large ones"),
)


def effects(kind: StageKind, stage: str, unit: str, moment_nm: float = 0.0) -> tuple[Effect, ...]:
    """Every effect that a stage of this kind can have.

    unit: of what is measured; moment_nm: of a pendulum's weight, which says what friction would be noticed.
    """
    uses = _KINDS[kind]
    return tuple(_effect(stage, name, uses, unit, moment_nm) for name in uses)


def _effect(stage: str, name: str, uses: Mapping[str, _Use], unit: str, moment_nm: float) -> Effect:
    use, registered = uses[name], REGISTRY[uses[name].origin]
    known = {p.name: p for p in registered.parameters}
    parameters = [_parameter(known[there], here, use, unit, moment_nm) for there, here in use.names.items()]
    if "torque" in use.names:
        parameters.append(_GIVE)
    differences = dict(text.split(": ", 1) for text in registered.separated_by.split("; ") if ": " in text)
    apart = {other: differences[u.origin] for other, u in uses.items() if u.origin in differences and other != name}
    for one, other, how in _RIVALS:
        if name in (one, other) and {one, other} <= uses.keys():
            apart[other if name == one else one] = how
    return Effect(
        f"{stage}.{name}",
        tuple(parameters),
        use.meaning or registered.meaning,
        registered.source,
        tuple(f"{stage}.{other}" for other in apart),
        "; ".join(f"{stage}.{other}: {how}" for other, how in apart.items()),
    )


def _parameter(p: Parameter, name: str, use: _Use, unit: str, moment_nm: float) -> Parameter:
    """The registry's parameter on this rig: its name, and for another unit its bounds."""
    neutral = use.neutral.get(p.name, p.neutral)
    found = replace(p, name=name, neutral=neutral, low=min(p.low, neutral) if math.isfinite(neutral) else p.low)
    if name == "torque" and moment_nm > 0:
        return replace(found, exemplar=_NOTICED_SHARE * moment_nm)
    if (unit, name) in _SPANS:
        low, high, usual = _SPANS[unit, name]
        return replace(found, unit=_unit(p.unit, unit), low=low, high=high, exemplar=usual)
    return found


def _unit(registered: str, unit: str) -> str:
    """The registry's unit with the length or pressure in it replaced by what is measured here."""
    if unit == "m/s":  # a follower of velocities: its rate is an acceleration
        return {"kPa": "m/s", "kPa/s": "m/s^2", "m/s^2": "m/s^3"}.get(registered, registered)
    base, slash, time = registered.partition("/")
    return f"{unit}{slash}{time}" if base in ("kPa", "m") else registered
