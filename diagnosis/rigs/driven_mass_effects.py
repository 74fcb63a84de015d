"""What a driven mass can have beyond its nominal model: the registry's effects, bounds and sizes of the rig's own.

A mass of grams under a coil and one of tonnes under a crane share no bound: each comes from the largest force, speed
and way that the recording holds, and from its clock.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from softarm.simulator.effect_table import Effect, Parameter, shape, strength
from softarm.simulator.effects import REGISTRY

_KARNOPP = "Olsson et al. 1998, Friction models and friction compensation"
_SPRING = "standard mechanics (two masses and a spring)"
_STRIBECK = "Armstrong-Helouvry et al. 1994, A survey of models for the control of machines with friction"

USUAL = 0.15  # of the usual force: a friction that one notices
GIVE_SHARE = 5e-5  # of the way: a bearing's friction bends by some hundredths of a millimetre

# Pairs that are easily taken for each other, and what tells them apart.
_RIVALS: tuple[tuple[str, str, str], ...] = (
    (
        "mass",
        "gain",
        "without another force in the model nothing can: motion tells force over mass alone. Known friction, a known "
        "weight on the incline or a known mass added does",
    ),
    ("mass", "damping", "a speed sweep: a mass resists changes of the speed, a viscous force the speed"),
    ("gain", "coulomb_friction", "forces of several sizes: dry friction takes the same from each, a gain a share"),
    ("gain", "ceiling", "an amplitude sweep: an end of the force leaves small ones alone"),
    ("coulomb_friction", "damping", "coasting: down a line against dry friction, down an exponential against viscous"),
    ("coulomb_friction", "deadband", "coasting without a force: friction brakes, an amplifier's dead zone does not"),
    ("coulomb_friction", "stiction", "slow motion against standing: only the break-away force is higher"),
    ("coulomb_friction", "backlash", "reversals under load: play shuts, friction stays"),
    ("coulomb_friction", "friction_asymmetry", "the same motion both ways"),
    (
        "force_offset",
        "friction_asymmetry",
        "on a rig that does not roll back by itself nothing in the motion can. Turn the rig round on its bench: "
        "friction that is larger one way turns with it, a tilt's pull stays with the bench",
    ),
    ("damping", "drag", "speeds of several sizes: drag grows with the square"),
    ("dead_time", "latency", "only their sum shows from force to reading; a second sensor splits it"),
    ("dead_time", "lag", "a step of the force: flat foot or slope at once; fast sines: a lag also makes them smaller"),
    ("lag", "latency", "a step of the force: flat foot or slope at once"),
    ("dead_time", "backlash", "reversals of several speeds: a dead time's wait stays, the way through play stays"),
    ("lag", "damping", "coasting: a lag of the force is over then"),
    ("compliance", "lag", "a short push: a spring swings on, a lag does not"),
    ("compliance", "latency", "a short push: a spring swings on"),
)


@dataclass(frozen=True, slots=True)
class Scales:
    """What the recordings of a rig span, in its own units."""

    length: str  # unit of the position
    push: str  # unit of the force: N, N m
    input_unit: str  # of what drives it: N, N m, A
    input: float  # largest
    force: float  # largest, after the nominal gain
    usual: float  # its mean size
    speed: float  # largest
    way: float  # peak to peak
    resolution: float  # of the position: step or noise
    step_s: float  # between samples
    period_s: float  # of its usual motion

    @property
    def units(self) -> Mapping[str, str]:
        """Of way, speed, force and what belongs to them."""
        return {
            "way": self.length,
            "speed": f"{self.length}/s",
            "force": self.push,
            "viscous": f"{self.push} s/{self.length}",
            "drag": f"{self.push} s^2/{self.length}^2",
        }


def effects(stage: str, scales: Scales, speed_alone: bool) -> tuple[Effect, ...]:
    """Every effect of a driven mass, in the order in which a force meets it. speed_alone: no position is measured."""
    found = dict(_effects(scales))
    for name in ("backlash", "compliance") if speed_alone else ("sensor_bias",):
        del found[name]
    apart: dict[str, dict[str, str]] = {name: {} for name in found}
    for one, other, how in _RIVALS:
        if {one, other} <= found.keys():
            apart[one][other] = apart[other][one] = how
    return tuple(
        Effect(
            f"{stage}.{name}",
            parameters,
            meaning,
            source,
            tuple(f"{stage}.{other}" for other in apart[name]),
            "; ".join(f"{stage}.{other}: {how}" for other, how in apart[name].items()),
        )
        for name, (parameters, meaning, source) in found.items()
    )


def _effects(s: Scales) -> Iterator[tuple[str, tuple[tuple[Parameter, ...], str, str]]]:
    late = min(0.5 * s.period_s, 200 * s.step_s)
    delay = (0.0, -0.5 * s.step_s, late, min(max(2 * s.step_s, 0.02 * s.period_s), 0.5 * late))
    yield (
        "dead_time",
        (
            (strength("delay", "s", *delay, "from the input to the first force"),),
            "the force comes late",
            REGISTRY["pressure.dead_time"].source,
        ),
    )
    yield (
        "deadband",
        (
            (strength("width", s.input_unit, 0.0, 0.0, 0.9 * s.input, 0.05 * s.input, "either way"),),
            "the amplifier makes no force of inputs up to the width, and of larger ones what is beyond it",
            "standard model of an amplifier or a valve with overlap (dead zone)",
        ),
    )
    yield (
        "ceiling",
        (
            (strength("limit", s.input_unit, math.inf, 0.1 * s.input, s.input, 0.7 * s.input, "either way"),),
            "the input acts no more than up to this: an amplifier's or a motor's end",
            "standard saturation; motors and amplifiers state a peak current",
        ),
    )
    yield (
        "lag",
        (
            (strength("time", "s", 0.0, 0.0, s.period_s, min(max(s.step_s, 0.03 * s.period_s), 0.3 * s.period_s), ""),),
            "the force follows the input as a first-order lag",
            REGISTRY["rail.lag"].source,
        ),
    )
    yield (
        "gain",
        (
            (strength("scale", "-", 0.0, -0.9, 4.0, 0.1, "relative error of the force a unit of input"),),
            "the input makes force x (1 + scale)",
            "force and torque constants are nominal values; Krishnan 2001, Electric Motor Drives",
        ),
    )
    yield (
        "mass",
        (
            (strength("scale", "-", 0.0, -0.9, 4.0, 0.1, "relative error of the mass or inertia"),),
            "mis-fit mass, or a load that the model does not know: x (1 + scale)",
            REGISTRY["arm.payload"].source,
        ),
    )
    yield from _forces(s)
    yield from _seen(s, delay)


def _forces(s: Scales) -> Iterator[tuple[str, tuple[tuple[Parameter, ...], str, str]]]:
    unit, f, v, give, u = s.units, s.force, s.speed, GIVE_SHARE * s.way, USUAL * s.usual
    yield (
        "coulomb_friction",
        (
            (
                strength("force", unit["force"], 0.0, 0.0, 1.5 * f, u, "either way; up to it the mass stays"),
                shape("give", unit["way"], give, 0.0, 100 * give, 2 * give, "way on which it bends before it slips"),
            ),
            "dry friction",
            REGISTRY["rail.coulomb_friction"].source,
        ),
    )
    yield (
        "friction_asymmetry",
        (
            (strength("force", unit["force"], 0.0, -0.5 * f, 0.5 * f, 0.5 * u, "more forwards, less backwards"),),
            "dry friction is larger one way than the other",
            _KARNOPP,
        ),
    )
    yield (
        "stiction",
        (
            (
                strength("force", unit["force"], 0.0, 0.0, f, 0.5 * u, "beyond the friction of sliding"),
                shape("speed", unit["speed"], 0.02 * v, 1e-3 * v, 0.5 * v, 0.05 * v, "at which it has faded to 37 %"),
            ),
            "dry friction is larger at rest and at creeping speed (Stribeck)",
            _STRIBECK,
        ),
    )
    yield (
        "damping",
        (
            (strength("viscous", unit["viscous"], 0.0, 0.0, 3 * f / v, u / v, "friction a velocity"),),
            "viscous friction; a motor's back-EMF acts alike",
            REGISTRY["rail.coulomb_friction"].source,
        ),
    )
    yield (
        "drag",
        (
            (strength("coefficient", unit["drag"], 0.0, 0.0, 3 * f / v**2, u / v**2, "of the speed's square"),),
            "quadratic drag",
            REGISTRY["arm.drag"].source,
        ),
    )
    yield (
        "force_offset",
        (
            (strength("force", unit["force"], 0.0, -f, f, 0.5 * u, "forwards"),),
            "a constant force: the rail is tilted, a weight or a spring pulls, the input's zero is off",
            REGISTRY["arm.tilt"].source,
        ),
    )


def _seen(
    s: Scales, delay: tuple[float, float, float, float]
) -> Iterator[tuple[str, tuple[tuple[Parameter, ...], str, str]]]:
    unit = s.units
    play = min(max(5 * s.resolution, 0.005 * s.way), 0.1 * s.way)
    slow, fast = 1.5 / s.period_s, 0.3 / s.step_s
    yield (
        "compliance",
        (
            (
                strength(
                    "share", "-", 0.0, -1.5, 4.0, 0.3, "-1 for a light end, or load over motor at the motor's end"
                ),
                shape("frequency", "Hz", 0.3 * fast, min(slow, 0.1 * fast), fast, 0.3 * fast, "of the free spring"),
                shape("ratio", "-", 0.05, 0.005, 0.7, 0.1, "damping ratio"),
            ),
            "a spring between what is driven and its load: the sensor sits on the load, or feels it swing",
            _SPRING,
        ),
    )
    yield (
        "backlash",
        (
            (strength("gap", unit["way"], 0.0, 0.0, 0.3 * s.way, play, "free travel between the flanks"),),
            REGISTRY["rail.backlash"].meaning,
            REGISTRY["rail.backlash"].source,
        ),
    )
    yield (
        "latency",
        (
            (strength("delay", "s", *delay, "age of a reading beyond what its stamp says"),),
            "readings are older than their stamps say",
            REGISTRY["mocap.latency"].source,
        ),
    )
    yield (
        "sensor_bias",
        (
            (
                strength(
                    "bias", unit["speed"], 0.0, -0.2 * s.speed, 0.2 * s.speed, 0.02 * s.speed, "reading less speed"
                ),
            ),
            "the speed's sensor has a wrong zero",
            REGISTRY["pressure.sensor_bias"].source,
        ),
    )
