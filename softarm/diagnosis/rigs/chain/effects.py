"""Effects of a chain of links; their bounds come from the chain's model and its recordings."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.chain.model import Chain
from softarm.diagnosis.rigs.effects import like, of_stage
from softarm.simulator.effect_table import Effect, Parameter, shape, strength
from softarm.simulator.effects import REGISTRY
from softarm.simulator.kernel.joints import REACH_RAD

# Errors that a good nominal model may have: of an angle's zero (a fifth of a degree), and shares of masses and lengths,
# of viscous friction next to a motor, of an inertia, and of a motor's constant and its current's zero.
ZERO_RAD = 3e-3
MASS_SHARE = 0.01
VISCOUS_SHARE = 0.2
INERTIA_SHARE = 0.05
DRIVE_SHARE = 0.05
# Angle beyond which a link goes over the top.
TURNED_RAD = 2.0
# Dry friction that matters, as a share of the weight's torque and of the motors' torque.
NOTICED_SHARE, NOTICED_DRIVEN = 0.003, 0.1
# Density times half the drag coefficient of a square as wide as the link is long, rounded up.
AIR_KG_M3 = 1.0

# Pairs that are easily mistaken for each other, and the motion that separates them.
_RIVALS: tuple[tuple[str, str, str], ...] = (
    ("damping", "coulomb_friction", "free decay: exponential envelope or a straight line"),
    ("damping", "drag", "an amplitude sweep: drag's decrement grows with the swing"),
    ("coulomb_friction", "drag", "an amplitude sweep: dry friction rules small swings, drag large ones"),
    ("stiffness", "stiffening", "an amplitude sweep: the period changes with the swing only for stiffening"),
    ("stiffness", "payload", "static hang and swing together: a mass changes both, in another ratio"),
    ("stiffness", "inertia", "hold still at several angles: only the weight shows there"),
    ("inertia", "payload", "hold still at several angles: only a payload shows there"),
    ("inertia", "gain", "hold still at several angles: the torque that is needed there knows no inertia"),
    ("gain", "stiffness payload stiffening", "swing without torque: its period knows no gain"),
    ("gain", "damping coulomb_friction drag", "swing without torque: its decay knows no gain"),
    ("gain", "sensor_bias tilt", "swing without torque: where it comes to rest knows no gain"),
    ("payload", "stiffening", "an amplitude sweep: the period changes with the swing only for stiffening"),
    ("inertia", "stiffening", "an amplitude sweep: the period changes with the swing only for stiffening"),
    ("coulomb_friction", "torque_offset", "hold still, come from either side: friction helps both, an offset one"),
    ("torque_offset", "stiffness payload gain", "hang still without torque: only an offset shows there"),
    ("sensor_bias", "stiffness payload", "hang still: only a zero shows there"),
    ("tilt", "stiffness payload", "hang still: only a lean shows there"),
    ("sensor_bias", "tilt", "turn the base by a half turn: only a tilt changes its sign"),
    ("torque_offset", "tilt", "add a known mass: a tilt's pull grows with it"),
    ("torque_offset", "sensor_bias", "swing without torque: an offset stays only if it is in the mechanics"),
    ("dead_time", "damping", "torque sines at two frequencies: a delay's phase grows with the frequency"),
    ("dead_time", "coulomb_friction", "torque sines at two frequencies: a delay's phase grows with the frequency"),
    ("dead_time", "drag", "torque sines at two frequencies: a delay's phase grows with the frequency"),
    ("dead_time", "inertia", "torque sines at two frequencies: a delay's phase grows with the frequency"),
    ("dead_time", "gain", "hold still at several angles: only a gain shows there"),
)


@dataclass(frozen=True, slots=True)
class ChainScales:
    """Scales of a chain's recordings; arrays [n] by joint."""

    torque_nm: Array  # RMS of the motor's torque; 0 without a motor
    top_nm: Array  # its largest value
    swing_rad: Array  # RMS of the joint's angle about its mean
    reach_rad: float  # largest angle of any link
    rate_rad_s: Array  # RMS of the joint's rate
    period_s: float  # of the slowest swing
    sample_s: float  # sampling interval of the torque
    driven: bool  # torques are recorded
    carried: bool  # the base moves


def chain_effects(stage: str, chain: Chain, scales: ChainScales) -> tuple[Effect, ...]:
    """Return every effect that this chain can show in its recordings."""
    return of_stage(stage, _effects(chain, scales), _RIVALS)


def tolerances(chain: Chain, scales: ChainScales) -> dict[str, Array]:
    """Return the errors that a good nominal model may have: 'effect.parameter' -> half-widths [n], or [1] for all."""
    found = {
        "stiffness.scale": np.array([MASS_SHARE]),
        "sensor_bias.bias": np.full(chain.n, ZERO_RAD),
        "damping.scale": np.full(chain.n, VISCOUS_SHARE),
    }
    if not scales.driven:
        # A published viscous friction was usually fitted as the only friction, so it is free.
        found["damping.scale"] = np.ones(chain.n)
        # The inertia is known no better than the masses and lengths that it is computed from.
        if scales.carried or chain.n > 1:
            found["inertia.scale"] = np.array([MASS_SHARE])
    else:
        found["inertia.scale"] = np.array([INERTIA_SHARE])
        found["gain.scale"] = np.full(chain.n, DRIVE_SHARE)
        found["torque_offset.torque"] = DRIVE_SHARE * scales.torque_nm
        found["dead_time.delay"] = np.array([scales.sample_s])
    return found


def of_joints(name: str, n: int) -> tuple[str, ...]:
    """Return a parameter's name for each of n joints: the name itself for one joint, numbered names for more."""
    return (name,) if n == 1 else tuple(f"{name}{i}" for i in range(1, n + 1))


def _effects(chain: Chain, scales: ChainScales) -> Iterator[Effect]:
    weight = chain.gravity > 0
    # A single free link shows only the ratio of its inertia to its weight.
    several = scales.driven or scales.carried or chain.n > 1
    if weight:
        yield like(
            "arm.stiffness",
            "wrong moment of the weight: m g a x (1 + scale)",
            "the links' weight moment is off by {scale}",
            *REGISTRY["arm.stiffness"].parameters[:1],
        )
    if chain.length[-1] > 0:  # otherwise the model does not give the position of the end
        mass = float(chain.mass.sum())
        yield like(
            "arm.payload",
            "extra mass at the end of the last link",
            "{mass} extra hang at the last link's end",
            strength("mass", "kg", 0.0, 0.0, mass, 0.1 * mass, "a point at the last link's end"),
        )
    if several:
        yield like(
            "arm.payload",
            "wrong inertia of the links about their joints: x (1 + scale)",
            "the links' inertia is off by {scale}",
            strength("scale", "-", 0.0, -0.8, 2.0, 0.2, "relative error, all links"),
            name="inertia",
        )
    yield from _friction(chain, scales)
    yield like(
        "pressure.sensor_bias",
        "the encoders' zeros are wrong, or the base leans",
        "the zeros of the joints' angles are off",
        *_by_joint("bias", "rad", np.full(chain.n, -0.2), np.full(chain.n, 0.2), np.full(chain.n, 5e-3)),
    )
    if weight and several:
        yield like(
            "arm.tilt",
            "the base is not level",
            "the base is tilted by {angle}",
            strength("angle", "rad", 0.0, -0.2, 0.2, 0.02, "of the base"),
        )
    if scales.driven:
        yield from _motors(chain, scales)


def _friction(chain: Chain, scales: ChainScales) -> Iterator[Effect]:
    load = _loads(chain, scales)
    yield like(
        "arm.damping",
        "wrong viscous friction in the joints",
        "the viscous friction in the joints is off",
        *_viscous(chain, scales),
    )
    noticed = NOTICED_DRIVEN * scales.torque_nm if scales.driven else NOTICED_SHARE * load
    noticed = np.maximum(noticed, NOTICED_SHARE * load)
    torques = _by_joint("torque", "N m", np.zeros(chain.n), np.maximum(load, 2 * chain.dry), chain.dry + noticed)
    give = shape("give", "rad", REACH_RAD, REACH_RAD, 0.05, 5e-3, "turn after which the friction has its full value")
    yield like(
        "arm.coulomb_friction", REGISTRY["arm.coulomb_friction"].meaning, "the joints have dry friction", *torques, give
    )
    if chain.gravity > 0 and scales.reach_rad < TURNED_RAD:  # it has no meaning for a link that goes round
        yield like(
            "arm.stiffening",
            "the moment grows with the angle: x (1 + cubic angle^2)",
            "the weight moment changes with the angle",
            *REGISTRY["arm.stiffening"].parameters,
        )
    most = float((AIR_KG_M3 * (2 * chain.centre) ** 2).max())
    yield like(
        "arm.drag",
        REGISTRY["arm.drag"].meaning,
        "air drag slows the links",
        strength("coefficient", "N s^2/m^2", 0.0, 0.0, most, 0.1 * most, "of each link, at its centre"),
    )


def _motors(chain: Chain, scales: ChainScales) -> Iterator[Effect]:
    n, load = chain.n, _loads(chain, scales)
    yield like(
        "pressure.gain",
        "the motors give torque x (1 + scale)",
        "the motors' torque is off",
        *_by_joint("scale", "-", np.full(n, -0.9), np.full(n, 2.0), np.full(n, 0.1), "relative error"),
    )
    yield like(
        "arm.torque_offset",
        "a constant torque at the joints; dry friction that is larger one way looks the same",
        "a constant torque acts at the joints",
        *_by_joint("torque", "N m", -load, load, 0.05 * np.maximum(scales.torque_nm, 0.1 * load)),
    )
    latest = 0.25 * scales.period_s
    yield like(
        "pressure.dead_time",
        "the torques act later than their stamps state",
        "the torques act {delay} late",
        strength("delay", "s", 0.0, 0.0, latest, 2 * scales.sample_s, "before a torque acts"),
    )


def _by_joint(
    name: str, unit: str, low: Array, high: Array, usual: Array, meaning: str = "", neutral: float = 0.0
) -> tuple[Parameter, ...]:
    """Return a parameter for each joint, with bounds and usual sizes [n]."""
    return tuple(
        strength(each, unit, neutral, float(low[i]), float(high[i]), float(usual[i]), meaning)
        for i, each in enumerate(of_joints(name, len(low)))
    )


def _loads(chain: Chain, scales: ChainScales) -> Array:
    """Largest torque at each joint [n]: its motor's, the weight's, or the torque that its swings need."""
    swings = chain.joint_inertia * scales.rate_rad_s * 2 * np.pi / scales.period_s
    return np.maximum(np.maximum(scales.top_nm, chain.weight_nm), swings)


def _viscous(chain: Chain, scales: ChainScales) -> tuple[Parameter, ...]:
    """Viscous friction as a share of the model's, or as a coefficient if the model has none.

    The upper bound stops every swing, or takes the motor's whole torque at the usual rate.
    """
    tops = chain.joint_inertia * 4 * np.pi / scales.period_s
    tops = np.maximum(tops, scales.top_nm / np.maximum(scales.rate_rad_s, 1e-9))
    if (chain.viscous > 0).all():
        # A share of -1 removes the friction: that is the neutral value, and 0 is the nominal one.
        least, most = np.full(chain.n, -1.0), np.maximum(4.0, tops / chain.viscous - 1)
        return _by_joint("scale", "-", least, most, np.full(chain.n, 0.5), "relative error", -1.0)
    own = chain.viscous
    return _by_joint("viscous", "N m s/rad", np.zeros(chain.n), tops + own, own + 0.02 * tops)
