"""Table of effects, one entry each, in causal order; `softarm.simulator.effects` gives access to it.

Sources: [P] the CoRL 2023 paper (sections; SM: its supplement), [C] its authors' released configuration; the others are
the standard model of the thing, named. Bounds are the physical worst case of a rig.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from string import Formatter

from softarm.common.quantity import Quantity

STAGES = ("pressure", "rail", "arm", "mocap", "observation", "clock", "contact")


@dataclass(frozen=True, kw_only=True)
class Parameter(Quantity):
    """Parameter of an effect; fits and randomisation stay within low .. high.

    Only a shape parameter (hysteresis.width) has a `default`, since it has no neutral value of its own.
    """

    neutral: float  # value at which the effect changes nothing; inf for a limit
    exemplar: float  # strong but possible value, for tests

    def __post_init__(self) -> None:
        """Allow the neutral value even outside the bounds."""
        object.__setattr__(self, "also", self.neutral)

    @property
    def otherwise(self) -> float:
        """Return the value in a model that has the effect but not this parameter."""
        return self.neutral if self.default is None else self.default


@dataclass(frozen=True)
class Effect:
    """Named physics, actuation, sensing or timing that a simulator, or a rig's nominal model, has or lacks."""

    name: str  # stage.effect
    parameters: tuple[Parameter, ...]  # none: on or off
    meaning: str
    source: str
    # The effect in a technician's words, with {stage} and its parameters: "the regulator reacts {delay} late".
    plain: str = field(kw_only=True)
    # Rival effect -> the experiment that separates the two, "motion: what it shows". Filled by `with_rivals`.
    separated_by: Mapping[str, str] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        """Raise ValueError if the plain sentence names a parameter that the effect lacks."""
        named = {field for _, field, _, _ in Formatter().parse(self.plain) if field}
        if unknown := named - {"stage", *(parameter.name for parameter in self.parameters)}:
            raise ValueError(f"{self.name}: its plain sentence names {', '.join(sorted(unknown))}; use its parameters")

    @property
    def stage(self) -> str:
        """Return the stage in the causal chain, one of STAGES."""
        return self.name.partition(".")[0]


def strength(name: str, unit: str, neutral: float, low: float, high: float, exemplar: float, meaning: str) -> Parameter:
    """Return a parameter that sets the strength of an effect."""
    return Parameter(name=name, unit=unit, neutral=neutral, low=low, high=high, exemplar=exemplar, meaning=meaning)


def shape(name: str, unit: str, default: float, low: float, high: float, exemplar: float, meaning: str) -> Parameter:
    """Return a parameter that sets the form of an effect and has no neutral value of its own."""
    return replace(strength(name, unit, default, low, high, exemplar, meaning), default=default)


def with_rivals(effects: Iterable[Effect], rivals: Iterable[tuple[str, str, str]]) -> tuple[Effect, ...]:
    """Return the effects with `separated_by` filled from pairs of names and the experiment that separates each pair.

    Pairs of which an effect is not among the given ones are skipped.
    """
    known = {effect.name: effect for effect in effects}
    separated: dict[str, dict[str, str]] = {name: {} for name in known}
    for one, other, experiment in rivals:
        if one in known and other in known:
            separated[one][other] = separated[other][one] = experiment
    return tuple(replace(effect, separated_by=separated[name]) for name, effect in known.items())


_P, _INF = strength, math.inf

EFFECTS = (
    Effect(
        "pressure.lag",
        (
            _P("inflate", "s", 0.0, 0.0, 2.0, 0.25, "time constant while the pressure rises"),
            _P("deflate", "s", 0.0, 0.0, 2.0, 0.35, "time constant while it falls"),
        ),
        "the pressure approaches its command exponentially, with an own time constant each way",
        "[P] section 3.3 (pressure regulator dynamics), SM-E; [C] keeps 0.81 / 0.86 a 30 Hz step: 0.158 s, 0.221 s",
        plain="the regulator follows slowly, with time constants of {inflate} up and {deflate} down",
    ),
    Effect(
        "pressure.dead_time",
        (_P("delay", "s", 0.0, 0.0, 0.2, 0.05, "from the command to the regulator's first reaction"),),
        "the regulator starts to react late",
        "[C] delays both commands by one 33 ms step, [P] the rail's alone",
        plain="the regulator reacts {delay} late",
    ),
    Effect(
        "pressure.rate_limit",
        (_P("rate", "kPa/s", _INF, 1.0, 1000.0, 40.0, "largest slope, either way"),),
        "choked flow: the pressure changes no faster than this",
        "ISO 6358-1 (choked flow through a valve); [P] section 3.3: finite flow rates",
        plain="the pressure changes by at most {rate}",
    ),
    Effect(
        "pressure.deadband",
        (_P("width", "kPa", 0.0, 0.0, 5.0, 0.5, "a command this close to the last one acted on is ignored"),),
        "the regulator ignores changes of its command that are smaller than this",
        "proportional regulators state a response sensitivity (Festo VPPI is the seed's, [P] SM-E)",
        plain="the regulator ignores changes below {width}",
    ),
    Effect(
        "pressure.gain",
        (
            _P("scale", "-", 0.0, -0.5, 0.5, 0.1, "relative error of the gain"),
            _P("offset", "kPa", 0.0, -3.0, 3.0, 0.5, "error of the zero"),
        ),
        "the regulator reaches command x (1 + scale) + offset",
        "proportional regulators state linearity and zero errors (Festo VPPI is the seed's, [P] SM-E)",
        plain="the regulator's gain is off by {scale} and its zero by {offset}",
    ),
    Effect(
        "pressure.ceiling",
        (_P("limit", "kPa", _INF, 1.0, 100.0, 12.0, "highest pressure that is reached"),),
        "the supply saturates",
        "the supply's pressure; [P] SM-E: commands to 20 kPa, bounds found by trial",
        plain="the pressure reaches at most {limit}",
    ),
    Effect(
        "pressure.leak",
        (_P("rate", "1/s", 0.0, 0.0, 2.0, 0.5, "share of the pressure that is lost in a second, valve shut"),),
        "an inflated muscle leaks: the pressure is lost in proportion to it, and a slow regulator makes up for a part",
        "isothermal vessel with a laminar leak: gauge pressure decays exponentially; the bound halves it in 0.35 s",
        plain="the muscle leaks {rate} of its pressure a second",
    ),
    Effect(
        "pressure.sensor_bias",
        (_P("bias", "kPa", 0.0, -5.0, 5.0, 1.0, "reading minus pressure"),),
        "the pressure sensor reads high; the arm feels the true pressure",
        "pressure sensors state a zero offset; [P] SM-E: the regulator's built-in sensor",
        plain="the pressure sensor reads {bias} off",
    ),
    Effect(
        "rail.servo",
        (),
        "the drive ramps a reference at rail.acceleration_limit, lags that by rail.lag and closes a velocity loop on "
        "it, its acceleration fed forward; where friction or a force limit hold the cart back, the ramp runs on. "
        "Absent: it tracks the acceleration until the velocity is near, and rail.lag comes before that",
        "the usual cascade of servo drives (CiA 402, profile velocity mode: 6083h, 60FFh); absent: [P] section 3.3",
        plain="the drive closes a velocity loop and ramps its reference",
    ),
    Effect(
        "rail.acceleration_limit",
        (_P("acceleration", "m/s^2", _INF, 0.5, 50.0, 4.0, "slope of the velocity"),),
        "the drive ramps its velocity at a fixed slope",
        "[P] section 3.3 (linear actuator dynamics): 6 m/s^2",
        plain="the cart accelerates at most with {acceleration}",
    ),
    Effect(
        "rail.force_limit",
        (_P("force", "N", _INF, 0.5, 200.0, 2.5, "most that the motor gives, either way"),),
        "the drive's motor gives no more force than this: the cart ramps slower and gives way to the arm",
        "a motor's peak torque over its pulley; drives cap it (CiA 402, object 6072h: max torque)",
        plain="the drive pushes with at most {force}",
    ),
    Effect(
        "rail.delay",
        (_P("delay", "s", 0.0, 0.0, 0.1, 0.05, "from the command to its first effect on the cart"),),
        "a velocity command takes effect late",
        "[P] section 3.3 (linear actuator latency), SM-E: one control step, 33 ms",
        plain="the cart reacts {delay} late",
    ),
    Effect(
        "rail.lag",
        (_P("time", "s", 0.0, 0.0, 0.5, 0.05, "time constant"),),
        "the drive's velocity set-point follows the command as a first-order lag",
        "standard model of a velocity loop (first order)",
        plain="the drive follows with a time constant of {time}",
    ),
    Effect(
        "rail.gain",
        (_P("scale", "-", 0.0, -0.2, 0.2, 0.05, "relative error of the velocity"),),
        "wrong feed constant: the cart moves at command x (1 + scale)",
        "CiA 402 drives derive speed from a feed constant that somebody enters; belts stretch and wear",
        plain="the cart's speed is off by {scale}",
    ),
    Effect(
        "rail.coulomb_friction",
        (
            _P("force", "N", 0.0, 0.0, 20.0, 2.0, "dry friction"),
            _P("viscous", "N s/m", 0.0, 0.0, 50.0, 3.0, "friction a velocity"),
        ),
        "friction of the cart that the drive does not cancel",
        "Coulomb and viscous friction; Olsson et al. 1998, Friction models and friction compensation",
        plain="the rail has friction: {force} dry and {viscous} viscous",
    ),
    Effect(
        "rail.backlash",
        (_P("gap", "m", 0.0, 0.0, 0.02, 0.002, "free travel between the flanks"),),
        "play at reversals: the drive crosses the gap before the driven part follows",
        "Nordin and Gutman 2002, Controlling mechanical systems with backlash: a survey",
        plain="the rail's drive has {gap} of play",
    ),
    Effect(
        "arm.stiffness",
        (_P("scale", "-", 0.0, -0.8, 2.0, 0.3, "relative error, all joints"),),
        "mis-fit stiffness: K x (1 + scale)",
        "[P] SM-B fits K; SM-F randomises it",
        plain="the arm's stiffness is off by {scale}",
    ),
    Effect(
        "arm.damping",
        (_P("scale", "-", 0.0, -0.9, 4.0, 0.5, "relative error, all joints"),),
        "mis-fit damping: D x (1 + scale)",
        "[P] SM-B fits D; SM-F randomises it",
        plain="the arm's damping is off by {scale}",
    ),
    Effect(
        "arm.muscle_gain",
        (_P("scale", "-", 0.0, -0.8, 2.0, 0.2, "relative error, all joints"),),
        "mis-fit muscle: b x (1 + scale)",
        "[P] SM-B fits b; SM-F randomises it",
        plain="the muscle's strength is off by {scale}",
    ),
    Effect(
        "arm.torque_offset",
        (_P("scale", "-", 0.0, -3.0, 3.0, 0.5, "relative error, all joints"),),
        "mis-fit constant torque: offset x (1 + scale); a scale of -1 is the paper's arm, without any",
        "[C] has the offset, [P] leaves it out",
        plain="the arm's constant bend is off by {scale}",
    ),
    Effect(
        "arm.coulomb_friction",
        (_P("torque", "N m", 0.0, 0.0, 0.2, 0.01, "in each joint"),),
        "dry friction in the joints",
        "Olsson et al. 1998, Friction models; measured on the MultiArm-Pendulum rig: small swings decay on a line",
        plain="the arm's joints have {torque} of dry friction",
    ),
    Effect(
        "arm.stiffening",
        (_P("cubic", "1/rad^2", 0.0, -0.1, 5.0, 0.5, "relative growth of the stiffness with the angle squared"),),
        "the springs stiffen: K theta (1 + cubic theta^2); below zero a beam that wrinkles",
        "Duffing's cubic spring; Comer and Levy 1963, Deflections of an inflated circular-cylindrical cantilever beam",
        plain="the arm's stiffness changes with its bend",
    ),
    Effect(
        "arm.hysteresis",
        (
            # From a half on, a reversal would first pull the wrong way.
            _P("strength", "-", 0.0, 0.0, 0.5, 0.3, "half height of the loop over its width"),
            shape(
                "width", "kPa", 2.0, 0.1, 20.0, 2.0, "change of pressure after which a reversal has turned (1 - 1/e)"
            ),
        ),
        "rate-independent loop between pressure and torque (Bouc-Wen)",
        "Bouc 1967; Wen 1976, Method for random vibration of hysteretic systems; muscle: Naclerio and Hawkes 2020",
        plain="the arm bends differently on the way up and down (hysteresis)",
    ),
    Effect(
        "arm.muscle_saturation",
        (_P("pressure", "kPa", _INF, 5.0, 500.0, 20.0, "where the torque levels off"),),
        "the muscle's torque levels off with pressure s: p becomes s tanh(p / s)",
        "standard smooth saturation; Naclerio and Hawkes 2020: a muscle's contraction is finite",
        plain="the muscle's torque levels off above {pressure}",
    ),
    Effect(
        "arm.payload",
        (_P("mass", "kg", 0.0, 0.0, 0.5, 0.05, "a point at the tip"),),
        "extra mass at the tip",
        "standard mechanics; markers and tools weigh, [P] SM-E: five marker sets",
        plain="{mass} extra hang at the tip",
    ),
    Effect(
        "arm.tilt",
        (_P("angle", "rad", 0.0, -0.2, 0.2, 0.03, "of the rail's frame; above zero, +y points uphill"),),
        "the rail's frame is not level: gravity pulls along the rail too",
        "standard mechanics; a floor is level to about 0.01 rad",
        plain="the rail is tilted by {angle}",
    ),
    Effect(
        "arm.drag",
        (_P("coefficient", "N s^2/m^2", 0.0, 0.0, 0.1, 0.02, "of each link, at its centre"),),
        "quadratic air drag",
        "rho C_d A / 2: 0.005 N s^2/m^2 for a link of the seed, a cylinder across the stream",
        plain="air drag slows the arm",
    ),
    Effect(
        "arm.creep",
        (
            _P("strength", "-", 0.0, 0.0, 1.0, 0.3, "share of the bending that comes late"),
            shape("time", "s", 5.0, 0.3, 100.0, 2.0, "time constant of that share"),
        ),
        "slow viscoelastic bending: a bent link keeps bending",
        "standard linear solid (Zener 1948); fabric beams creep",
        plain="a bent arm keeps bending slowly (creep)",
    ),
    Effect(
        "mocap.latency",
        (_P("delay", "s", 0.0, 0.0, 0.2, 0.02, "age of a pose beyond what its stamp says"),),
        "poses are older than their stamp says",
        "cameras, tracking and network take milliseconds; vendors state a part of them",
        plain="the cameras' poses are {delay} older than their stamps",
    ),
    Effect(
        "mocap.dropout",
        (_P("share", "-", 0.0, 0.0, 0.9, 0.1, "of the frames"),),
        "frames are missing: the last pose is repeated",
        "markers hide and packets are lost (Bernoulli)",
        plain="the cameras lose {share} of the frames",
    ),
    Effect(
        "mocap.rotation",
        (_P("angle", "rad", 0.0, -0.2, 0.2, 0.03, "turns the poses from y towards z"),),
        "the mocap's frame is turned against the rail's",
        "calibration: the ground plane is set by hand",
        plain="the cameras' frame is turned by {angle}",
    ),
    Effect(
        "mocap.scale",
        (_P("scale", "-", 0.0, -0.1, 0.1, 0.02, "relative error of lengths"),),
        "the mocap measures lengths x (1 + scale)",
        "calibration: the wand's length",
        plain="the cameras measure lengths {scale} off",
    ),
    Effect(
        "mocap.offset",
        (
            _P("y", "m", 0.0, -0.1, 0.1, 0.01, "along the rail"),
            _P("z", "m", 0.0, -0.1, 0.1, 0.01, "upwards"),
        ),
        "the mocap's origin is not the rail's",
        "calibration: the origin is set by hand, and marker sets sit on a surface, not on the axis",
        plain="the cameras' origin is off by {y} and {z}",
    ),
    Effect(
        "mocap.noise",
        (_P("sigma", "m", 0.0, 0.0, 0.02, 0.002, "standard deviation of each coordinate"),),
        "white noise on the measured positions",
        "standard sensor model; OptiTrack states tenths of a millimetre ([P] SM-E: Flex 13)",
        plain="the measured positions have {sigma} of noise",
    ),
    Effect(
        "observation.finite_difference",
        (),
        "velocities are first differences over a control step, not true ones",
        "[P] section 3.3 (velocity measurements)",
        plain="the velocities are differences of positions",
    ),
    Effect(
        "clock.jitter",
        (_P("sigma", "s", 0.0, 0.0, 0.02, 0.003, "standard deviation of a tick's lateness"),),
        "the loop does not tick on time",
        "operating systems wake late; `python -m benchmarks.loop` measures it",
        plain="the ticks of the loop vary by {sigma}",
    ),
    Effect(
        "clock.missed_ticks",
        (_P("share", "-", 0.0, 0.0, 0.5, 0.05, "of the ticks"),),
        "ticks are left out: the last command holds on",
        "a late loop skips whole periods; `python -m benchmarks.loop` counts them",
        plain="the loop misses {share} of its ticks",
    ),
    Effect(
        "clock.drift",
        (_P("rate", "-", 0.0, -0.01, 0.01, 0.002, "seconds that the cameras' stamps gain in a second"),),
        "the cameras' clock runs fast or slow against the loop's: by its stamp a pose looks ever newer or older",
        "quartz keeps 20 to 50 ppm; a wrong frame rate or a clock that nothing disciplines is off by a thousandth",
        plain="the cameras' clock runs {rate} off",
    ),
    Effect(
        "contact.friction",
        (_P("coefficient", "-", 0.0, 0.0, 2.0, 0.4, "Coulomb's"),),
        "friction between arm and shelf",
        "Coulomb friction; [C] has a frictionless shelf",
        plain="the shelf has friction, coefficient {coefficient}",
    ),
    Effect(
        "contact.stiffness",
        (_P("stiffness", "N/m", 2000.0, 100.0, 100000.0, 5000.0, "force a depth"),),
        "how hard the shelf's surface is; without this effect it has the neutral value",
        "penalty contact; Hunt and Crossley 1975, Coefficient of restitution interpreted as damping",
        plain="the shelf's stiffness is {stiffness}",
    ),
)

# Pairs of effects that explain similar data, and the experiment that separates them.
RIVALS = (
    ("pressure.lag", "pressure.dead_time", "a step: flat foot or slope at once; a multisine over a decade"),
    ("pressure.lag", "pressure.rate_limit", "steps of several sizes: the time grows with the step only for a limit"),
    ("pressure.lag", "pressure.sensor_bias", "long holds at several levels, reached from above and below"),
    ("pressure.lag", "arm.hysteresis", "the same loop at three rates: its area stays for hysteresis"),
    ("pressure.dead_time", "pressure.deadband", "ramps of several slopes: the wait stays for a dead time"),
    (
        "pressure.lag",
        "pressure.leak",
        "long holds at several levels: only a leak leaves the pressure below its command",
    ),
    ("pressure.gain", "pressure.leak", "step up and down: a leak also shortens the time constants, a gain does not"),
    ("pressure.gain", "pressure.sensor_bias", "the arm feels a wrong gain, never a sensor's bias"),
    ("pressure.gain", "pressure.ceiling", "an amplitude sweep: a ceiling leaves low pressures alone"),
    ("pressure.gain", "arm.muscle_gain", "the pressure is measured: the muscle's gain does not show in it"),
    ("pressure.gain", "arm.muscle_saturation", "the pressure is measured: saturation does not show in it"),
    ("pressure.ceiling", "arm.muscle_saturation", "the pressure is measured: saturation does not show in it"),
    ("rail.acceleration_limit", "rail.lag", "steps of several sizes: the time grows with the step only for a limit"),
    (
        "rail.acceleration_limit",
        "rail.force_limit",
        "ramps while the arm swings, or with a payload: a limited slope stays, a limited motor is pushed and slower",
    ),
    ("rail.force_limit", "rail.coulomb_friction", "coasting: friction brakes a cart that no motor drives, a limit not"),
    ("rail.delay", "mocap.latency", "only the sum shows from command to mocap; the axis's own read-back splits it"),
    ("rail.gain", "mocap.scale", "the axis's read-back against mocap: the read-back has the true travel or not"),
    ("rail.gain", "rail.coulomb_friction", "a speed sweep: a gain's error grows, dry friction's not"),
    ("rail.coulomb_friction", "rail.backlash", "reversals under load: play shuts, friction stays"),
    ("arm.stiffness", "arm.muscle_gain", "free swing without pressure: only stiffness changes its period"),
    ("arm.stiffness", "arm.torque_offset", "the rest shape at several pressures: an offset shifts all alike"),
    ("arm.stiffness", "arm.stiffening", "an amplitude sweep: the period changes with the swing only for stiffening"),
    ("arm.stiffness", "arm.payload", "static hang and swing together: a mass changes both, in another ratio"),
    ("arm.stiffness", "arm.creep", "a fast swing against a long hold: creep softens only the hold"),
    ("arm.damping", "arm.coulomb_friction", "free decay: exponential envelope or a straight line"),
    ("arm.damping", "arm.drag", "an amplitude sweep: drag's decrement grows with the swing"),
    ("arm.coulomb_friction", "arm.hysteresis", "swing without pressure: the muscle's loop is gone, friction is not"),
    ("arm.muscle_gain", "arm.torque_offset", "rest shapes with and without pressure"),
    ("arm.muscle_gain", "arm.muscle_saturation", "an amplitude sweep: saturation leaves low pressures alone"),
    ("arm.torque_offset", "arm.tilt", "turn the base round, or add a known mass: a tilt's pull grows with it"),
    ("arm.hysteresis", "arm.creep", "the same loop at three rates: its area stays for hysteresis"),
    ("arm.tilt", "mocap.rotation", "the cart's poses along the rail: a turned frame shows there"),
    ("mocap.rotation", "mocap.offset", "points far from each other: an offset shifts all alike"),
    ("mocap.latency", "observation.finite_difference", "difference the recorded poses by their stamps, offline"),
    ("mocap.dropout", "mocap.noise", "repeated poses: noise never repeats one"),
    ("mocap.latency", "clock.drift", "the stamps of reception: a late pose stays as late, a drift grows with the time"),
    ("mocap.dropout", "clock.missed_ticks", "the stamps: a missed tick has none"),
    ("mocap.dropout", "clock.jitter", "the stamps' distances: spread or doubled"),
)
