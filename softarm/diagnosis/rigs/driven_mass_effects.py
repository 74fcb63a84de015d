"""Effects of a mass that a force moves: a cart on a rail, a motor's axis, a linear stage.

Bounds and usual sizes come from the largest force, speed and travel of the recordings, and from their sampling.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

from softarm.diagnosis.rigs.effects import backlash, damping, drag, dry_friction, latency, like, of_stage, stiction
from softarm.simulator.effect_table import Effect, Parameter, shape, strength

# Share of the usual force: a friction that matters.
USUAL = 0.15
# Share of the travel: a bearing's friction bends by some hundredths of a millimetre before it slips.
GIVE_SHARE = 5e-5

# Pairs that are easily mistaken for each other, and the motion that separates them.
_RIVALS: tuple[tuple[str, str, str], ...] = (
    ("mass", "gain", "a run with a known added mass, incline or friction: without it only force over mass shows"),
    ("mass", "damping", "a speed sweep: a mass resists changes of the speed, a viscous force the speed"),
    ("gain", "coulomb_friction", "forces of several sizes: dry friction takes the same from each, a gain a share"),
    ("gain", "ceiling", "an amplitude sweep: an end of the force leaves small ones alone"),
    ("coulomb_friction", "damping", "coasting: the speed falls linearly with dry friction, exponentially with viscous"),
    ("coulomb_friction", "deadband", "coasting without a force: friction brakes, an amplifier's dead zone does not"),
    ("coulomb_friction", "stiction", "slow motion and breaking away: only stiction makes breaking away harder"),
    ("coulomb_friction", "backlash", "reversals under load: play shuts, friction stays"),
    ("coulomb_friction", "friction_asymmetry", "the same motion both ways: only asymmetric friction differs"),
    ("force_offset", "friction_asymmetry", "the same motion after turning the rig round: a tilt's pull does not turn"),
    ("damping", "drag", "speeds of several sizes: drag grows with the square"),
    ("dead_time", "latency", "the same motion with a second sensor: its stamps separate the two, one shows the sum"),
    ("dead_time", "lag", "a step of the force: a dead time starts flat; fast sines: a lag also makes them smaller"),
    ("lag", "latency", "a step of the force: a late reading starts flat, a lag with a slope"),
    ("dead_time", "backlash", "reversals of several speeds: a dead time's wait stays, the way through play stays"),
    ("lag", "damping", "coasting: a lag of the force has no effect then"),
    ("compliance", "lag", "a short push: a spring swings on, a lag does not"),
    ("compliance", "latency", "a short push: a spring swings on"),
)


@dataclass(frozen=True, slots=True)
class DrivenMassScales:
    """Scales of a driven mass's recordings, in the rig's own units."""

    length: str  # unit of the position
    force_unit: str  # unit of the force: N, N m
    input_unit: str  # unit of the input: N, N m, A, V
    input: float  # largest input
    force: float  # largest force, after the nominal gain
    usual: float  # mean size of the force
    speed: float  # largest speed
    travel: float  # peak to peak
    resolution: float  # step or noise of the position
    step_s: float  # sampling interval
    period_s: float  # period of the usual motion

    @property
    def speed_unit(self) -> str:
        """Unit of the speed."""
        return f"{self.length}/s"


def driven_mass_effects(stage: str, scales: DrivenMassScales, speed_alone: bool) -> tuple[Effect, ...]:
    """Return every effect that a driven mass can show in its recordings, in the order in which a force meets it.

    speed_alone: whether the speed is measured and the position is not.
    """
    hidden = ("backlash", "compliance") if speed_alone else ("sensor_bias",)
    effects = [*_drive(scales), *_forces(scales), *_sensor(scales)]
    return of_stage(stage, [effect for effect in effects if effect.name not in hidden], _RIVALS)


def _drive(s: DrivenMassScales) -> Iterator[Effect]:
    yield like(
        "pressure.dead_time",
        "the force comes late",
        "the force on {stage} comes {delay} late",
        _delay("from the input to the first force", s),
    )
    yield Effect(
        "deadband",
        (strength("width", s.input_unit, 0.0, 0.0, 0.9 * s.input, 0.05 * s.input, "either way"),),
        "the amplifier makes no force of inputs up to the width, and reduces larger ones by the width",
        "standard model of an amplifier or a valve with overlap (dead zone)",
        plain="the amplifier of {stage} ignores inputs below {width}",
    )
    yield Effect(
        "ceiling",
        (strength("limit", s.input_unit, math.inf, 0.1 * s.input, s.input, 0.7 * s.input, "either way"),),
        "the input acts only up to this: an amplifier's or a motor's limit",
        "standard saturation; motors and amplifiers state a peak current",
        plain="the force on {stage} ends at {limit}",
    )
    slowness = min(max(s.step_s, 0.03 * s.period_s), 0.3 * s.period_s)
    yield like(
        "rail.lag",
        "the force follows the input as a first-order lag",
        "the force on {stage} follows with a time constant of {time}",
        strength("time", "s", 0.0, 0.0, s.period_s, slowness, "time constant"),
    )
    yield Effect(
        "gain",
        (strength("scale", "-", 0.0, -0.9, 4.0, 0.1, "relative error of the force per unit of input"),),
        "the input makes force x (1 + scale)",
        "force and torque constants are nominal values; Krishnan 2001, Electric Motor Drives",
        plain="the force on {stage} is off by {scale}",
    )
    yield like(
        "arm.payload",
        "wrong mass, or a load that the model lacks: x (1 + scale)",
        "the mass of {stage} is off by {scale}",
        strength("scale", "-", 0.0, -0.9, 4.0, 0.1, "relative error of the mass or inertia"),
        name="mass",
    )


def _forces(s: DrivenMassScales) -> Iterator[Effect]:
    force, speed, give, usual = s.force, s.speed, GIVE_SHARE * s.travel, USUAL * s.usual
    half = 0.5 * force
    yield dry_friction(
        strength("force", s.force_unit, 0.0, 0.0, 1.5 * force, usual, "either way; up to it the mass stays"),
        shape("give", s.length, give, 0.0, 100 * give, 2 * give, "travel over which it bends before it slips"),
    )
    yield Effect(
        "friction_asymmetry",
        (strength("force", s.force_unit, 0.0, -half, half, 0.5 * usual, "more forwards, less backwards"),),
        "dry friction is larger one way than the other",
        "Olsson et al. 1998, Friction models and friction compensation",
        plain="the dry friction of {stage} differs by direction, {force} either way",
    )
    yield stiction(
        strength("force", s.force_unit, 0.0, 0.0, force, 0.5 * usual, "beyond the sliding friction"),
        shape("speed", s.speed_unit, 0.02 * speed, 1e-3 * speed, 0.5 * speed, 0.05 * speed, "where 37 % remain"),
    )
    per_speed, per_square = f"{s.force_unit} s/{s.length}", f"{s.force_unit} s^2/{s.length}^2"
    top = 3 * force / speed
    yield damping(strength("viscous", per_speed, 0.0, 0.0, top, usual / speed, "friction per unit of speed"))
    top = 3 * force / speed**2
    yield drag(strength("coefficient", per_square, 0.0, 0.0, top, usual / speed**2, "times the speed squared"))
    yield like(
        "arm.tilt",
        "a constant force: the rail is tilted, a weight or a spring pulls, or the input's zero is wrong",
        "a constant force of {force} pulls at {stage}",
        strength("force", s.force_unit, 0.0, -force, force, 0.5 * usual, "forwards"),
        name="force_offset",
    )


def _sensor(s: DrivenMassScales) -> Iterator[Effect]:
    play = min(max(5 * s.resolution, 0.005 * s.travel), 0.1 * s.travel)
    slow, fast = 1.5 / s.period_s, 0.3 / s.step_s
    yield Effect(
        "compliance",
        (
            strength("share", "-", 0.0, -1.5, 4.0, 0.3, "-1 for a light load, or load over motor with a motor encoder"),
            shape("frequency", "Hz", 0.3 * fast, min(slow, 0.1 * fast), fast, 0.3 * fast, "of the free spring"),
            shape("ratio", "-", 0.05, 0.005, 0.7, 0.1, "damping ratio"),
        ),
        "a spring between the drive and its load: the sensor sits on the load, or on the drive that the load shakes",
        "standard mechanics (two masses and a spring)",
        plain="a spring between drive and load of {stage} swings at {frequency}",
    )
    yield backlash(strength("gap", s.length, 0.0, 0.0, 0.3 * s.travel, play, "free travel between the flanks"))
    yield latency(_delay("age of a reading beyond its stamp", s))
    most = 0.2 * s.speed
    yield like(
        "pressure.sensor_bias",
        "the speed sensor has a wrong zero",
        "the speed sensor of {stage} reads {bias} off",
        strength("bias", s.speed_unit, 0.0, -most, most, 0.02 * s.speed, "reading minus speed"),
    )


def _delay(meaning: str, s: DrivenMassScales) -> Parameter:
    latest = min(0.5 * s.period_s, 200 * s.step_s)
    usual = min(max(2 * s.step_s, 0.02 * s.period_s), 0.5 * latest)
    return strength("delay", "s", 0.0, -0.5 * s.step_s, latest, usual, meaning)
