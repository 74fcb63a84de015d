"""What a chain may do otherwise than its model: the registry's effects, their bounds from the chain and its data."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs.chain.model import Chain
from softarm.simulator.effect_table import shape
from softarm.simulator.effects import REGISTRY, Effect, Parameter
from softarm.simulator.kernel.joints import REACH_RAD

ZERO_RAD = 3e-3  # how well an angle's zero is set: a fifth of a degree
MASS_SHARE = 0.01  # how well masses and arms are weighed
VISCOUS_SHARE = 0.2  # how well viscous friction is known beside a motor
INERTIA_SHARE = 0.05  # how well an inertia is reckoned
DRIVE_SHARE = 0.05  # how well a motor's constant is known, and its current's zero
TURNED_RAD = 2.0  # beyond, a link goes over the top
NOTICED_SHARE, NOTICED_DRIVEN = 0.003, 0.1  # of the weight, and of the motors' torque: dry friction that is noticed
AIR_KG_M3 = 1.0  # density times drag coefficient over two, of a square as wide as the link is long, rounded up


@dataclass(frozen=True, slots=True)
class Scales:
    """What a chain's recording is like; arrays [n] by joint."""

    torque_nm: Array  # RMS of the motor's; 0 without one
    top_nm: Array  # its largest
    swing_rad: Array  # RMS of the joint's angle about its middle
    reach_rad: float  # the largest angle of any link
    rate_rad_s: Array  # RMS
    period_s: float  # of the slowest swing
    sample_s: float  # of the torque
    driven: bool  # torques are there
    carried: bool  # the base moves


def effects(stage: str, chain: Chain, scales: Scales) -> tuple[Effect, ...]:
    """Every effect that a chain can have. A free one does not tell its inertia from its weight."""
    parameters = dict(_parameters(chain, scales))
    apart: dict[str, dict[str, str]] = {name: {} for name in parameters}
    for one, other, how in _RIVALS:
        if {one, other} <= parameters.keys():
            apart[one][other] = apart[other][one] = how
    return tuple(
        Effect(
            f"{stage}.{name}",
            found,
            _MEANINGS[name],
            REGISTRY[_ORIGINS[name]].source,
            tuple(f"{stage}.{other}" for other in apart[name]),
            "; ".join(f"{stage}.{other}: {how}" for other, how in apart[name].items()),
        )
        for name, found in parameters.items()
    )


def tolerances(chain: Chain, scales: Scales) -> dict[str, Array]:
    """Half widths of what a well-kept model may be off by: effect.parameter, by joint -> [n], or [1] of all."""
    found = {
        "stiffness.scale": np.array([MASS_SHARE]),
        "sensor_bias.bias": np.full(chain.n, ZERO_RAD),
        "damping.scale": np.full(chain.n, VISCOUS_SHARE),
    }
    if not scales.driven:
        # Fitted as the only one, a published viscous friction took the others' share: it is fitted anew.
        found["damping.scale"] = np.ones(chain.n)
        if scales.carried or chain.n > 1:  # masses and arms that are weighed so well leave it so well known at best
            found["inertia.scale"] = np.array([MASS_SHARE])
    else:
        found["inertia.scale"] = np.array([INERTIA_SHARE])
        found["gain.scale"] = np.full(chain.n, DRIVE_SHARE)
        found["torque_offset.torque"] = DRIVE_SHARE * scales.torque_nm
        found["dead_time.delay"] = np.array([scales.sample_s])
    return found


def of_joints(name: str, n: int) -> tuple[str, ...]:
    """A parameter's names: itself of a single link, else with the joint's number."""
    return (name,) if n == 1 else tuple(f"{name}{i}" for i in range(1, n + 1))


def _parameters(chain: Chain, scales: Scales) -> Iterator[tuple[str, tuple[Parameter, ...]]]:
    n, load = chain.n, _loads(chain, scales)
    mass = float(chain.mass.sum())
    if chain.gravity > 0:
        yield "stiffness", (REGISTRY["arm.stiffness"].parameters[0],)
    if chain.length[-1] > 0:  # else nobody says where its end is
        yield "payload", (_P("mass", "kg", 0.0, 0.0, mass, 0.1 * mass, "a point at the last link's end"),)
    if scales.driven or scales.carried or n > 1:
        yield "inertia", (_P("scale", "-", 0.0, -0.8, 2.0, 0.2, "relative error, all links"),)
    yield "damping", _viscous(chain, scales)
    noticed = NOTICED_DRIVEN * scales.torque_nm if scales.driven else NOTICED_SHARE * load
    noticed = np.maximum(noticed, NOTICED_SHARE * load)
    named = zip(of_joints("torque", n), noticed, load, chain.dry, strict=True)
    give = shape("give", "rad", REACH_RAD, REACH_RAD, 0.05, 5e-3, "turn after which the friction has its full value")
    torques = [_P(name, "N m", 0.0, 0.0, max(top, 2 * dry), dry + usual, "") for name, usual, top, dry in named]
    yield "coulomb_friction", (*torques, give)
    if chain.gravity > 0 and scales.reach_rad < TURNED_RAD:  # of a link that goes round it would say nothing
        yield "stiffening", REGISTRY["arm.stiffening"].parameters
    tops = AIR_KG_M3 * (2 * chain.centre) ** 2
    top = float(tops.max())
    yield "drag", (_P("coefficient", "N s^2/m^2", 0.0, 0.0, top, 0.1 * top, "of each link, at its centre"),)
    bias = [_P(name, "rad", 0.0, -0.2, 0.2, 5e-3, "") for name in of_joints("bias", n)]
    yield "sensor_bias", tuple(bias)
    if chain.gravity > 0 and (scales.driven or scales.carried or n > 1):
        yield "tilt", (_P("angle", "rad", 0.0, -0.2, 0.2, 0.02, "of the base"),)
    if scales.driven:
        yield "gain", tuple(_P(name, "-", 0.0, -0.9, 2.0, 0.1, "relative error") for name in of_joints("scale", n))
        drives = zip(of_joints("torque", n), scales.torque_nm, load, strict=True)
        offsets = [_P(name, "N m", 0.0, -top, top, 0.05 * max(rms, 0.1 * top), "") for name, rms, top in drives]
        yield "torque_offset", tuple(offsets)
        late = 0.25 * scales.period_s
        yield "dead_time", (_P("delay", "s", 0.0, 0.0, late, 2 * scales.sample_s, "before a torque acts"),)


def _P(name: str, unit: str, neutral: float, low: float, high: float, usual: float, meaning: str) -> Parameter:
    return Parameter(
        name=name, unit=unit, neutral=neutral, low=float(low), high=float(high), exemplar=float(usual), meaning=meaning
    )


def _loads(chain: Chain, scales: Scales) -> Array:
    """[n] the largest torque that there is at each joint: its motor's, the weight's, or what its swings need."""
    swings = chain.joint_inertia * scales.rate_rad_s * 2 * np.pi / scales.period_s
    return np.maximum(np.maximum(scales.top_nm, chain.weight_nm), swings)


def _viscous(chain: Chain, scales: Scales) -> tuple[Parameter, ...]:
    """A share of the model's, where it has any; else a coefficient.

    At the top nothing would swing; or at the usual rate it would take all that a motor has.
    """
    tops = chain.joint_inertia * 4 * np.pi / scales.period_s
    tops = np.maximum(tops, scales.top_nm / np.maximum(scales.rate_rad_s, 1e-9))
    if (chain.viscous > 0).all():
        # The model has viscous friction; a joint may have none. So the neutral value is none, and nominal is 0.
        shares = zip(of_joints("scale", chain.n), tops / chain.viscous, strict=True)
        return tuple(_P(name, "-", -1.0, -1.0, max(4.0, top - 1), 0.5, "relative error") for name, top in shares)
    named = zip(of_joints("viscous", chain.n), tops, chain.viscous, strict=True)
    return tuple(_P(name, "N m s/rad", 0.0, 0.0, top + own, own + 0.02 * top, "") for name, top, own in named)


_ORIGINS = {
    "stiffness": "arm.stiffness",
    "payload": "arm.payload",
    "inertia": "arm.payload",
    "damping": "arm.damping",
    "coulomb_friction": "arm.coulomb_friction",
    "stiffening": "arm.stiffening",
    "drag": "arm.drag",
    "sensor_bias": "pressure.sensor_bias",
    "tilt": "arm.tilt",
    "gain": "pressure.gain",
    "torque_offset": "arm.torque_offset",
    "dead_time": "pressure.dead_time",
}
_MEANINGS = {
    "stiffness": "mis-fit moment of the weight: m g a x (1 + scale)",
    "payload": REGISTRY["arm.payload"].meaning,
    "inertia": "mis-fit inertia of the links about their joints: x (1 + scale)",
    "damping": "mis-fit viscous friction in the joints",
    "coulomb_friction": REGISTRY["arm.coulomb_friction"].meaning,
    "stiffening": "the moment grows with the angle: x (1 + cubic angle^2)",
    "drag": REGISTRY["arm.drag"].meaning,
    "sensor_bias": "the encoders' zeros are off, or the base leans",
    "tilt": "the base is not level",
    "gain": "the motors give torque x (1 + scale)",
    "torque_offset": "a constant torque at the joints; dry friction that differs from one way to the other is the same",
    "dead_time": "the torques act later than their stamps say",
}
_RIVALS: tuple[tuple[str, str, str], ...] = (
    ("damping", "coulomb_friction", "free decay: exponential envelope or a straight line"),
    ("damping", "drag", "an amplitude sweep: drag's decrement grows with the swing"),
    ("coulomb_friction", "drag", "an amplitude sweep: dry friction rules small swings, drag large ones"),
    ("stiffness", "stiffening", "an amplitude sweep: the period changes with the swing only for stiffening"),
    ("stiffness", "payload", "static hang and swing together: a mass changes both, in another ratio"),
    ("stiffness", "inertia", "hold still at several angles: only the weight shows there"),
    ("inertia", "payload", "hold still at several angles: only a payload shows there"),
    ("inertia", "gain", "hold still at several angles: the torque that is needed there knows no inertia"),
    ("stiffness", "gain", "swing without torque: its period knows no gain"),
    ("payload", "gain", "swing without torque: its period knows no gain"),
    ("stiffening", "gain", "swing without torque: its period knows no gain"),
    ("damping", "gain", "swing without torque: its decay knows no gain"),
    ("coulomb_friction", "gain", "swing without torque: its decay knows no gain"),
    ("drag", "gain", "swing without torque: its decay knows no gain"),
    ("sensor_bias", "gain", "swing without torque: where it comes to rest knows no gain"),
    ("tilt", "gain", "swing without torque: where it comes to rest knows no gain"),
    ("payload", "stiffening", "an amplitude sweep: the period changes with the swing only for stiffening"),
    ("inertia", "stiffening", "an amplitude sweep: the period changes with the swing only for stiffening"),
    ("coulomb_friction", "torque_offset", "hold still, come from either side: friction helps both, an offset one"),
    ("stiffness", "torque_offset", "hang still without torque: only an offset shows there"),
    ("payload", "torque_offset", "hang still without torque: only an offset shows there"),
    ("gain", "torque_offset", "hang still without torque: only an offset shows there"),
    ("stiffness", "sensor_bias", "hang still: only a zero shows there"),
    ("stiffness", "tilt", "hang still: only a lean shows there"),
    ("payload", "sensor_bias", "hang still: only a zero shows there"),
    ("payload", "tilt", "hang still: only a lean shows there"),
    ("sensor_bias", "tilt", "turn the base by a half turn: only a tilt changes its sign"),
    ("torque_offset", "tilt", "add a known mass: a tilt's pull grows with it"),
    ("torque_offset", "sensor_bias", "swing without torque: an offset stays only if it is in the mechanics"),
    ("dead_time", "damping", "torque sines at two frequencies: a delay's phase grows with the frequency"),
    ("dead_time", "coulomb_friction", "torque sines at two frequencies: a delay's phase grows with the frequency"),
    ("dead_time", "drag", "torque sines at two frequencies: a delay's phase grows with the frequency"),
    ("dead_time", "inertia", "torque sines at two frequencies: a delay's phase grows with the frequency"),
    ("dead_time", "gain", "hold still at several angles: only a gain shows there"),
)
