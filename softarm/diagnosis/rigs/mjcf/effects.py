"""Effects of one joint of a MuJoCo model and its actuator; bounds and usual sizes come from model and recordings."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from softarm.diagnosis.rigs.effects import backlash, damping, drag, dry_friction, latency, like, of_stage, stiction
from softarm.diagnosis.rigs.mjcf.links import PLACE
from softarm.diagnosis.rigs.mjcf.mechanism import Joint
from softarm.simulator.effect_table import Effect, Parameter, shape, strength

# Relative error of an actuator's gain, at least: some models state fifty times the gain of the servo.
LEAST_GAIN = -0.998
# Relative error of masses, at least: with less, all torques could shrink together, and no data would show it.
LEAST_MASS = -0.5
# Effects of an actuator that have one size for all joints that it moves.
ACTUATOR = "gain", "position_gain", "lag", "dead_time"
# Beginning of the name of a gain, if several actuators move the joint.
GAIN_OF = "gain_"
# Beginning of the name of an error of one part's mass.
MASS = "mass_"
# Share of the usual torque: a friction that matters.
USUAL = 0.15
# Least payload that loads a joint fully, as a share of the mechanism's mass: a light wrist's own torque says little.
CARRIED = 0.3
# Multiple of a usual friction from which the torque that the motion does not need sets the scale, and of that torque up
# to which a friction is sought.
LOST = 2.0
# Usual travel over which dry friction bends before it slips: rad, and as a share of a slide's travel.
GIVE_RAD, GIVE_SHARE = 1e-3, 1e-3
# Largest speed at which friction at rest fades, as a share of the fastest motion; one that fades later is dry friction.
CREEP = 0.3
# The same of friction in a gear: at this one it is practically constant.
CONSTANT = 5.0

# Pairs that are easily mistaken for each other, and the motion that separates them.
_RIVALS: tuple[tuple[str, str, str], ...] = (
    ("armature", "gain", "hold still at several angles: a gain changes the torque there, an inertia does not"),
    ("armature", "mass", "hold still at several angles: only the weight shows there"),
    ("length", "armature", "hold still at several angles: a longer link weighs more there"),
    ("length", "mass payload", "measure the link, or swing the next joint alone: its pull grows with the length"),
    ("mass", "payload", "hold still at several angles: a payload's arm is longer"),
    ("gain", "mass", "swing without torque, or another known mass: only one of them changes then"),
    ("coulomb_friction", "damping", "free decay: the swing falls linearly with dry friction"),
    ("coulomb_friction", "deadband", "move slowly against a known load: friction helps to hold it, a dead zone gives"),
    ("coulomb_friction", "stiction", "slow motion and breaking away: only stiction makes breaking away harder"),
    ("coulomb_friction", "load_friction", "the same motion with another load: only load friction grows with it"),
    ("coulomb_friction", "backlash", "reversals under load: play shuts, friction stays"),
    ("damping", "drag", "speeds of several sizes: drag grows with the square"),
    ("deadband", "backlash", "reversals under load: play shuts, a dead zone stays"),
    ("dead_time", "lag", "a step of the command: a dead time starts flat"),
    ("dead_time", "latency", "the same motion with a second sensor: its stamps separate the two"),
    ("lag", "latency", "a step of the command: a late reading starts flat, a lag with a slope"),
    ("rate_limit", "lag", "steps of several sizes: the time grows with the step only for a limit"),
    ("gain", "position_gain", "fast and slow motion: a gain changes the loop's damping as well"),
    ("ceiling", "gain", "an amplitude sweep: a limit leaves small torques alone"),
    ("spring", "payload mass", "hold still at several angles: a spring's torque is linear in the angle"),
    ("command_bias", "sensor_bias", "hold still at several angles: a wrong zero changes the weight's torque"),
    ("torque_offset", "sensor_bias", "hold still at several angles: a wrong zero changes the weight's torque"),
    ("tilt", "sensor_bias command_bias torque_offset spring payload", "put a spirit level on the base"),
)


@dataclass(frozen=True, slots=True)
class JointScales:
    """Scales of a joint's recordings, in rad and N m (a hinge) or m and N (a slide)."""

    joint: Joint
    driven: bool  # by an actuator or a measured torque
    follows: bool  # the actuator is a position loop
    actuators: tuple[str, ...]  # if several motors move the joint
    torque: float  # largest torque that the motion and the loads need
    usual: float  # mean size of that torque
    lost: float  # mean torque of a motor that acts along the motion and that the motion does not need
    load: float  # largest torque of the weight and of the other joints' motion
    mass: float  # share of the load that the masses behind the joint make, 0 or 1
    payloads_kg: tuple[float, ...]  # that double the torque, along each axis of the last link; inf without effect
    moving_kg: float  # mass of the mechanism without its fixed base
    reach: float  # usual distance of a payload from the last joint, m; 0 for a balanced link
    either_side: bool  # whether a payload may be on the other side of that joint than the link's centre of mass
    carries: bool  # another joint follows, so that the length of the link matters
    tilts: tuple[str, ...]  # horizontal axes about which a tilt of the base loads the joint
    inertia: float  # of the joint
    speed: float
    travel: float  # peak to peak
    resolution: float  # step or noise of the position
    step_s: float  # sampling interval
    period_s: float  # period of the usual motion
    command_rate: float  # fastest change of the command per second; 0 without a command

    @property
    def payload_kg(self) -> float:
        """Mass at the end that doubles the usual torque; inf if a mass has no effect."""
        return self.payloads_kg[0] if self.shows_payload else min(self.payloads_kg)

    @property
    def shows_payload(self) -> bool:
        """Whether a payload along the last link loads the joint; a last joint that turns it about itself shows none."""
        return math.isfinite(self.payloads_kg[0])

    @property
    def give(self) -> float:
        """Usual travel over which dry friction bends before it slips."""
        return GIVE_RAD if self.joint.turns else GIVE_SHARE * self.travel

    @property
    def length(self) -> str:
        """Unit of the position."""
        return "rad" if self.joint.turns else "m"

    @property
    def force(self) -> str:
        """Unit of the torque."""
        return "N m" if self.joint.turns else "N"


def joint_effects(stage: str, scales: JointScales) -> tuple[Effect, ...]:
    """Return every effect that a joint can show in its recordings, in the order in which a command meets it."""
    drive = _drive(scales) if scales.driven else ()
    return of_stage(stage, [*drive, *_friction(scales), *_bodies(scales), *_sensor(scales)], _RIVALS)


def of_actuator(effect: str) -> bool:
    """Return whether an effect has one size for all joints that its actuator moves."""
    return effect in ACTUATOR or effect.startswith(GAIN_OF)


def adds_mass(effect: str) -> bool:
    """Return whether an effect of the whole mechanism is a payload or another mass of one body."""
    return effect == "payload" or effect.startswith(MASS)


def common_effects(stage: str, parts: Iterable[str], scales: JointScales) -> tuple[Effect, ...]:
    """Return the effects that a joint shows only together with others.

    Args:
        stage: name of the joint.
        parts: first bodies of the parts that it moves, each of which may have another mass.
        scales: scales of its recordings. A joint in a position loop that turns the last link about itself shows a
            payload across the link; without a loop it would fall within a window.
    """
    across = scales.follows and not scales.shows_payload and math.isfinite(scales.payload_kg)
    payload = [_payload(scales)] if across else []
    return of_stage(stage, [*map(_heavier, parts), *payload], ())


def _heavier(part: str) -> Effect:
    return like(
        "arm.payload",
        f"{part}, with all that moves as one with it, has another mass",
        f"the mass of {part} is off by {{scale}}",
        _share_of("the part's masses and inertias"),
        name=MASS + part,
    )


def _share_of(masses: str) -> Parameter:
    return strength("scale", "-", 0.0, LEAST_MASS, 4.0, 0.1, f"relative error of {masses}")


def _drive(s: JointScales) -> Iterator[Effect]:
    late = min(0.5 * s.period_s, 100 * s.step_s)
    usual = min(max(2 * s.step_s, 0.02 * s.period_s), 0.5 * late)
    yield like(
        "pressure.dead_time",
        "the actuator reacts late",
        "the actuator of {stage} reacts {delay} late",
        strength("delay", "s", 0.0, -0.5 * s.step_s, late, usual, "from the command to the first torque"),
    )
    yield like(
        "rail.lag",
        "the actuator follows its command as a first-order lag (a filter activation)",
        "the actuator of {stage} follows with a time constant of {time}",
        strength("time", "s", 0.0, 0.0, late, usual, "time constant"),
    )
    yield from (_gain(GAIN_OF + name, f"gain of the actuator {name}") for name in s.actuators)
    if not s.actuators:
        yield _gain("gain", "actuator's gain")
    if s.follows:
        yield from _loop(s)
    else:
        yield like(
            "arm.torque_offset",
            "a constant torque acts at the joint",
            "a constant {torque} acts at {stage}",
            strength("torque", s.force, 0.0, -s.torque, s.torque, 0.5 * USUAL * s.usual, ""),
        )
    if s.actuators:
        return
    yield Effect(
        "ceiling",
        (strength("limit", s.force, math.inf, 0.1 * s.torque, 3 * s.torque, 0.7 * s.torque, "either way"),),
        "the actuator's torque ends at this (forcerange)",
        "standard saturation; motors and amplifiers state a peak current",
        plain="the torque of {stage} ends at {limit}",
    )


def _gain(name: str, whose: str) -> Effect:
    return Effect(
        name,
        (strength("scale", "-", 0.0, LEAST_GAIN, 4.0, 0.1, "relative error of gain and bias"),),
        "the actuator makes torque x (1 + scale)",
        "force and torque constants are nominal values; Krishnan 2001, Electric Motor Drives",
        plain=f"the {whose} of {{stage}} is off by {{scale}}" if name == "gain" else f"the {whose} is off by {{scale}}",
    )


def _loop(s: JointScales) -> Iterator[Effect]:
    """Yield the effects of a position loop."""
    most = 0.2 * s.travel
    yield Effect(
        "position_gain",
        (strength("scale", "-", 0.0, LEAST_GAIN, 4.0, 0.1, "relative error of kp"),),
        "the position loop is stiffer or softer: kp x (1 + scale)",
        "standard proportional position loop",
        plain="the position loop of {stage} has a gain that is off by {scale}",
    )
    yield like(
        "pressure.sensor_bias",
        "the zero of the commands differs from the zero of the readings",
        "the commands of {stage} are off by {bias}",
        strength("bias", s.length, 0.0, -most, most, 0.02 * s.travel, "added to the command"),
        name="command_bias",
    )
    yield like(
        "pressure.deadband",
        "errors of the position up to the width make no torque",
        "{stage} ignores errors below {width}",
        strength("width", s.length, 0.0, 0.0, 0.2 * s.travel, 0.01 * s.travel, "either way"),
    )
    slow = max(s.speed, 1e-6)
    fast = max(s.command_rate, 2 * slow)
    yield like(
        "pressure.rate_limit",
        "the position that the loop follows moves no faster than this (a servo's profile speed)",
        "{stage} moves by at most {rate}",
        strength(
            "rate", f"{s.length}/s", math.inf, 0.5 * slow, fast, 0.8 * slow, "of the position that the loop follows"
        ),
    )


def _friction(s: JointScales) -> Iterator[Effect]:
    usual, dry = USUAL * s.usual, s.joint.friction
    most, exemplar = _range(s.lost, max(1.5 * s.torque, 3 * dry), dry + usual)
    yield dry_friction(
        strength("torque", s.force, 0.0, 0.0, most, exemplar, "frictionloss"),
        shape("give", s.length, s.give, 0.0, 20 * s.give, 2 * s.give, "travel over which it bends before it slips"),
    )
    slow, most = 0.05 * s.speed, CREEP * s.speed
    yield stiction(
        strength("torque", s.force, 0.0, 0.0, s.torque, usual, "beyond the sliding friction"),
        shape("speed", f"{s.length}/s", slow, 1e-3 * s.speed, most, slow, "37 % remain"),
    )
    if s.driven:
        yield Effect(
            "load_friction",
            (
                strength("share", "-", 0.0, 0.0, 0.9, 0.1, "of the torque that holds the joint"),
                shape("from_load", "-", 0.5, 0.0, 1.0, 0.5, "part that belongs to the load, not to the actuator"),
                shape("speed", f"{s.length}/s", s.speed, 0.05 * s.speed, CONSTANT * s.speed, s.speed, "37 % remain"),
            ),
            "dry friction grows with the torques on both sides of a gear, and may fade with the speed (Stribeck)",
            "Duclusaud et al. 2024, Extended friction models for the physics simulation of servo actuators, M3 to M5",
            plain="the friction of {stage} grows by {share} of its torque",
        )
    yield from _of_speed(s)


def _range(lost: float, most: float, exemplar: float) -> tuple[float, float]:
    """Return the bound and the usual size of a friction, enlarged if the lost torque is far above the usual size."""
    return (max(most, LOST * lost), lost) if lost > LOST * exemplar else (most, exemplar)


def _of_speed(s: JointScales) -> Iterator[Effect]:
    """Yield friction that grows with the speed."""
    usual, per_speed, per_square = USUAL * s.usual, f"{s.force} s/{s.length}", f"{s.force} s^2/{s.length}^2"
    top, own = 3 * s.torque / s.speed, s.joint.viscous
    most, exemplar = _range(s.lost / s.speed, max(top, 3 * own), own + usual / s.speed)
    yield damping(strength("viscous", per_speed, 0.0, 0.0, most, exemplar, "per unit of speed"))
    top, exemplar = top / s.speed, usual / s.speed**2
    yield drag(strength("coefficient", per_square, 0.0, 0.0, top, exemplar, "times the speed squared"))


def _bodies(s: JointScales) -> Iterator[Effect]:
    unit, usual = "kg m^2" if s.joint.turns else "kg", s.joint.armature + 0.2 * s.inertia
    yield Effect(
        "armature",
        (strength("inertia", unit, 0.0, 0.0, 10 * s.inertia, usual, "of the rotor, behind its gear"),),
        "the inertia of the rotor",
        "standard mechanics: rotor inertia times the squared gear ratio",
        plain="the rotor of {stage} has an inertia of {inertia}",
    )
    if s.mass:
        yield like(
            "arm.payload",
            "the bodies behind the joint have another mass",
            "the mass behind {stage} is off by {scale}",
            _share_of("all masses and inertias behind the joint"),
            name="mass",
        )
    if s.shows_payload:
        yield _payload(s)
    if s.carries:
        yield Effect(
            "length",
            (strength("scale", "-", 0.0, -0.5, 0.5, 0.1, "relative error of the distance to the next joint"),),
            "the link has another length, with its mass as it is",
            "geometry of the rigid body: a tape measure",
            plain="the link of {stage} is {scale} longer",
        )
    if s.tilts:
        yield Effect(
            "tilt",
            tuple(strength(axis, "rad", 0.0, -0.3, 0.3, 0.05, f"about the model's {axis} axis") for axis in s.tilts),
            "the base is not level: gravity has another direction in the model's frame",
            "geometry of the rigid body: a spirit level",
            plain="the base that carries {stage} is not level",
        )
    own = s.joint.spring
    top, usual = max(3 * s.torque / s.travel, 3 * own), own + USUAL * s.usual / s.travel
    yield like(
        "arm.stiffness",
        "a spring acts at the joint: a cable, a tube, a balancer",
        "a spring of {stiffness} acts at {stage}",
        strength("stiffness", f"{s.force}/{s.length}", 0.0, 0.0, top, usual, "about its rest"),
        name="spring",
    )


def _payload(s: JointScales) -> Effect:
    far, along, across = s.reach, "from the last joint, along its link", "across the link"
    place = (
        shape("distance", "m", far, -2 * far * s.either_side, 2 * far, far, along),
        *(shape(axis, "m", 0.0, -2 * far, 2 * far, far, across) for axis in PLACE[1:]),
    )
    full = max(s.payload_kg, CARRIED * s.moving_kg)
    return like(
        "arm.payload",
        "extra mass at the end of the mechanism",
        "{mass} extra hang at the end, behind {stage}",
        strength("mass", "kg", 0.0, 0.0, 10 * full, USUAL * full, "a point on the last link"),
        *(place if s.reach else ()),
    )


def _sensor(s: JointScales) -> Iterator[Effect]:
    play = min(max(5 * s.resolution, 0.005 * s.travel), 0.1 * s.travel)
    yield backlash(strength("gap", s.length, 0.0, 0.0, 0.3 * s.travel, play, "free travel between the flanks"))
    if s.load:
        most = 0.2 if s.joint.turns else 0.2 * s.travel
        yield like(
            "pressure.sensor_bias",
            "the joint's zero is wrong, so its load acts at another angle",
            "the zero of {stage} is off by {bias}",
            strength("bias", s.length, 0.0, -most, most, 0.1 * most, "reading minus true position"),
        )
    if s.driven:
        late = min(0.5 * s.period_s, 100 * s.step_s)
        usual = min(2 * s.step_s, 0.5 * late)
        yield latency(strength("delay", "s", 0.0, -0.5 * s.step_s, late, usual, "beyond its stamp"))
