"""Faults of rigs: how they are drawn, and which names a diagnosis may give them.

A fault is drawn for a rig from its own scales; `size` is 1 for a fault that an owner notices and 0.5 for half of it.
Names are the registry's, without the stage.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from validation.rigs.follower import INNER_SHARE
from validation.rigs.presets import Plant, Rig, damping_of, mass_of, moments_of

Patch = Mapping[str, float | tuple[float, ...]]


@dataclass(frozen=True, slots=True)
class Draw:
    """Draw of one fault: the rig, the size of the fault, the random numbers, and scales of the rig."""

    rig: Rig
    size: float
    random: np.random.Generator

    @property
    def reach(self) -> float:
        """Return half of the range of the command, in the base unit."""
        return self.rig.reach

    @property
    def pace_s(self) -> float:
        """Return the time scale of the rig, s."""
        return self.rig.pace_s

    @property
    def inner_s2(self) -> float:
        """Return the position error of a follower per unit of its inner loop's acceleration, s^2."""
        return INNER_SHARE * self.pace_s**2

    @property
    def force_n(self) -> float:
        """Return a typical force on a cart, N."""
        return 0.6 * mass_of(self.rig) * self.reach / self.pace_s**2

    @property
    def speed_m_s(self) -> float:
        """Return a typical speed of a cart, m/s."""
        return 0.7 * self.reach / self.pace_s

    @property
    def moment_nm(self) -> float:
        """Return the moment of the weight on the first joint of a chain, N m."""
        return moments_of(self.rig)[0]

    def of_link(self, name: str, index: int = 0) -> float:
        """Return a number of the rig, of one of its links if there are several."""
        return float(np.ravel(self.rig.parameters[name])[index])

    def share(self, low: float, high: float) -> float:
        """Draw a factor, uniform in its logarithm."""
        return math.exp(self.random.uniform(math.log(low), math.log(high)))

    def uniform(self, low: float, high: float) -> float:
        """Draw a number that does not depend on the size."""
        return self.random.uniform(low, high)

    def sized(self, low: float, high: float, scale: float = 1.0) -> float:
        """Draw a share, low .. high, of a scale."""
        return self.size * self.share(low, high) * scale

    def either_way(self, low: float, high: float, scale: float = 1.0) -> float:
        """Draw a share, low .. high, of a scale, of either sign."""
        sign = float(self.random.choice((-1.0, 1.0)))
        return sign * self.sized(low, high, scale)


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault: its draw, and the names that are right for it."""

    patch: Callable[[Draw], Patch]
    names: frozenset[str] = frozenset()  # each of these is right; empty: outside the vocabulary
    tied: frozenset[str] = frozenset()  # may be listed too, as indistinguishable from it
    must: frozenset[str] = frozenset()  # must all be listed: the recordings of the case cannot distinguish them
    near: frozenset[str] = frozenset()  # of a fault outside: names of a part of it (verdict incomplete)
    also: frozenset[str] = frozenset()  # an effect that comes with it and is named as well

    def draw(self, rig: Rig, size: float, random: np.random.Generator) -> Patch:
        """Draw the parameters of a rig with this fault."""
        return self.patch(Draw(rig, size, random))


_one = frozenset

# Followers of commands: axes and chambers.


def _late(d: Draw) -> float:
    return d.size * max(d.share(0.35, 0.6) * d.pace_s, 2.0 / d.rig.rate_hz)


def _lag(d: Draw) -> Patch:
    factor = 1 + d.size * d.share(0.45, 0.8)
    return {"lag_s": d.pace_s * (factor if d.random.random() < 0.7 else 1 / factor)}


def _ripple(d: Draw) -> Patch:
    """Draw cogging: its error, and a few periods within the reach."""
    if d.rig.plant == "velocity axis":
        ripple = d.sized(0.06, 0.1, d.reach) / d.pace_s
        return {"ripple": ripple, "ripple_pitch": d.reach * max(6 * d.pace_s, 0.2)}
    return {"ripple": d.sized(0.04, 0.07, d.reach) / d.inner_s2, "ripple_pitch": d.reach / d.uniform(2.0, 4.0)}


def _friction(d: Draw) -> Patch:
    """Draw dry friction a mass that holds an error of a few hundredths of the reach."""
    held = d.sized(0.04, 0.07, d.reach)
    return dict.fromkeys(
        ("friction_up", "friction_down"), held / (d.pace_s if d.rig.plant == "velocity axis" else d.inner_s2)
    )


def _stick_slip(d: Draw) -> Patch:
    return {**_friction(d), "stiction": d.uniform(2.5, 3.5), "stribeck": 0.1 * d.reach / max(d.pace_s, 0.1)}


def _mode(d: Draw) -> Patch:
    # Half the size: a spring that is twice as stiff, so it gives way by half.
    return {"mode_rad_s": d.share(1.3, 2.2) / d.pace_s / math.sqrt(d.size), "mode_zeta": d.uniform(0.12, 0.3)}


def _rate(d: Draw) -> float:
    return float(d.share(0.22, 0.38) / d.size**0.7 * d.reach / d.pace_s)


def _steady(d: Draw) -> float:
    return d.either_way(0.05, 0.1, d.reach)


def _ceiling(d: Draw) -> float:
    return d.rig.centre + d.reach * (1 - d.size * d.uniform(0.45, 0.6))


def _slipping(d: Draw) -> Patch:
    slip = d.size * d.uniform(0.04, 0.08) * d.reach
    return {"slip": slip, "slip_above": d.uniform(0.5, 0.8) * d.reach / d.inner_s2}


_LATE, _ZERO = _one({"dead_time", "latency"}), _one({"gain", "sensor_bias"})
_LOOSE = _one({"backlash", "hysteresis", "deadband"})
_FOLLOWER = {
    "dead_time": Fault(lambda d: {"delay_s": _late(d)}, _one({"dead_time"}), _LATE),
    "latency": Fault(lambda d: {"late_s": _late(d)}, _LATE),
    "lag": Fault(_lag, _one({"lag"})),
    "rate_limit": Fault(lambda d: {"rate": _rate(d)}, _one({"rate_limit"})),
    "acceleration_limit": Fault(
        lambda d: {"acceleration": d.share(0.5, 0.9) / d.size * d.reach / d.pace_s**2}, _one({"acceleration_limit"})
    ),
    "deadband": Fault(lambda d: {"dead_zone": d.sized(0.05, 0.09, d.reach)}, _one({"deadband"}), _LOOSE),
    "friction": Fault(_friction, _one({"deadband", "coulomb_friction"}), _LOOSE),
    "gain": Fault(lambda d: {"gain": d.either_way(0.08, 0.15)}, _one({"gain"}), _ZERO),
    "offset": Fault(lambda d: {"offset": _steady(d)}, _one({"gain"}), _ZERO),
    "load": Fault(lambda d: {"load": _steady(d) / d.inner_s2}, _one({"gain", "force_offset"}), _ZERO),
    "ceiling": Fault(lambda d: {"ceiling": _ceiling(d)}, _one({"ceiling"})),
    "sensor_bias": Fault(lambda d: {"bias": _steady(d)}, _ZERO),
    "backlash": Fault(lambda d: {"gap": d.sized(0.06, 0.1, d.reach)}, _one({"backlash"}), _LOOSE),
    "hysteresis": Fault(
        lambda d: {"loop_width": d.sized(0.25, 0.4, d.reach)}, _one({"hysteresis"}), _one({"backlash"})
    ),
    "second_order": Fault(_mode, _one({"second_order"})),
    "cogging": Fault(_ripple),
    "stick-slip": Fault(_stick_slip, near=_LOOSE | {"coulomb_friction", "stiction"}),
    "drifting gain": Fault(lambda d: {"drift": d.either_way(0.15, 0.25)}, near=_one({"gain"})),
    "slipping": Fault(_slipping),
    "hum": Fault(lambda d: {"hum": d.sized(0.04, 0.07, d.reach)}),
    "wear": Fault(lambda d: {"gap": 1.6 * d.sized(0.06, 0.1, d.reach), "wear": 0.05}, near=_LOOSE),
}


def _uneven_lag(d: Draw) -> Patch:
    slow = 1 + d.size * d.share(0.7, 1.2)
    return {"lag_down_s": slow * d.pace_s if d.random.random() < 0.7 else d.pace_s / slow}


def _orifice(d: Draw) -> float:
    """Draw an orifice; a wide open one fills a reach in a few of the rig's times."""
    passes = 0.6 * (d.of_link("supply_kpa") + 101.3)
    return float(d.share(0.25, 0.4) / d.size**0.7 * d.reach / d.pace_s / passes)


_SHARED_WITH_CHAMBER = (
    *("dead_time", "latency", "lag", "deadband", "gain", "offset", "sensor_bias", "hysteresis", "second_order"),
    *("drifting gain", "hum"),
)
_CHAMBER = {name: _FOLLOWER[name] for name in _SHARED_WITH_CHAMBER} | {
    "uneven lag": Fault(_uneven_lag, _one({"lag"})),
    "choked flow": Fault(lambda d: {"orifice_1_s": _orifice(d)}, _one({"rate_limit"})),
    "weak supply": Fault(lambda d: {"supply_kpa": _ceiling(d)}, _one({"ceiling"})),
}

# Carts.


def _force(d: Draw) -> float:
    return d.sized(0.1, 0.25, d.force_n)


def _even_friction(d: Draw) -> Patch:
    return dict.fromkeys(("friction_up_n", "friction_down_n"), _force(d))


def _uneven_friction(d: Draw) -> Patch:
    level = d.share(0.1, 0.25) * d.force_n
    return {"friction_up_n": level * (1 + 0.5 * d.size), "friction_down_n": level * (1 - 0.5 * d.size)}


_SCALED, _PULLED = _one({"gain", "mass", "payload"}), _one({"force_offset", "friction_asymmetry", "tilt"})
_CART = {
    "coulomb_friction": Fault(_even_friction, _one({"coulomb_friction"}), _one({"stiction"})),
    "uneven friction": Fault(_uneven_friction, _one({"friction_asymmetry"}), _PULLED, also=_one({"coulomb_friction"})),
    "damping": Fault(lambda d: {"viscous_n_s_m": _force(d) / d.speed_m_s}, _one({"damping"})),
    "drag": Fault(lambda d: {"drag_n_s2_m2": 1.3 * _force(d) / d.speed_m_s**2}, _one({"drag"})),
    "slope": Fault(lambda d: {"force_n": d.either_way(0.1, 0.25, d.force_n)}, _one({"force_offset", "tilt"}), _PULLED),
    "payload": Fault(lambda d: {"mass_kg": mass_of(d.rig) * (1 + d.size * d.share(0.15, 0.35))}, _SCALED),
    "weak motor": Fault(lambda d: {"gain": d.sized(0.12, 0.25, -1.0)}, _SCALED),
    "dead_time": Fault(lambda d: {"delay_s": 0.3 * _late(d)}, _one({"dead_time"}), _one({"latency"})),
    "lag": Fault(lambda d: {"lag_s": 0.3 * _late(d)}, _one({"lag"}), _one({"dead_time", "latency"})),
    "compliance": Fault(
        lambda d: {"spring_rad_s": d.share(5.0, 9.0) / d.pace_s / math.sqrt(d.size)},
        _one({"compliance", "second_order"}),
    ),
    "backlash": Fault(lambda d: {"gap_m": d.sized(0.03, 0.06, d.reach)}, _one({"backlash"})),
    "cogging": Fault(lambda d: {"ripple_n": _force(d), "ripple_pitch_m": d.reach / d.uniform(2.0, 4.0)}),
    "hum": Fault(lambda d: {"hum_n": _force(d)}),
    "bumper": Fault(lambda d: {"bumper_n_m": 6 * _force(d) / d.reach, "bumper_m": d.uniform(0.0, 0.3) * d.reach}),
    "tiring motor": Fault(lambda d: {"drift": d.sized(0.25, 0.4)}, near=_SCALED),
    "wear": Fault(lambda d: {**_even_friction(d), "wear": 0.05}, near=_one({"coulomb_friction", "stiction"})),
}

# Chains of links.


def _each(joints: tuple[float, ...], share: float) -> tuple[float, ...]:
    return tuple(share * joint for joint in joints)


def _joint_friction(d: Draw, low: float, high: float, factor: float = 1.0) -> tuple[float, ...]:
    """Draw dry friction in every joint, N m."""
    return _each(moments_of(d.rig), factor * d.sized(low, high))


def _chain_drag(d: Draw) -> float:
    mass, centre, own = map(d.of_link, ("mass_kg", "centre_m", "inertia_kg_m2"))
    return d.size * d.share(0.04, 0.08) * (mass * centre**2 + own) / centre**3


def _tip_payload(d: Draw) -> Patch:
    return {"payload_kg": d.sized(0.1, 0.2, d.of_link("mass_kg", -1)), "payload_m": d.of_link("length_m", -1)}


_LEAN, _HEAVY = _one({"sensor_bias", "tilt"}), _one({"stiffness", "payload"})
_CHAIN = {
    "coulomb_friction": Fault(
        lambda d: {"friction_nm": _joint_friction(d, 0.004, 0.008)}, _one({"coulomb_friction"}), _one({"stiction"})
    ),
    "damping": Fault(
        lambda d: {"viscous_nm_s": _each(damping_of(d.rig), 1 + d.size * d.share(2.5, 4.0))}, _one({"damping"})
    ),
    "drag": Fault(lambda d: {"drag_n_s2_m2": _chain_drag(d)}, _one({"drag"})),
    "lean": Fault(lambda d: {"tilt_rad": d.either_way(0.03, 0.06)}, _LEAN),
    "bias": Fault(lambda d: {"bias_rad": d.either_way(0.03, 0.06)}, _LEAN),
    # A mass at the tip slows the swing, so only a low moment resembles one.
    "moment": Fault(lambda d: {"moment": d.sized(0.06, 0.12)}, _one({"stiffness"})),
    "low moment": Fault(lambda d: {"moment": d.sized(0.06, 0.12, -1.0)}, _one({"stiffness"}), _HEAVY),
    "payload": Fault(_tip_payload, _one({"payload"}), _HEAVY),
    "kink": Fault(
        lambda d: {"kink_nm_rad": d.sized(0.2, 0.4, d.moment_nm), "kink_rad": d.uniform(0.03, 0.12)},
        near=_HEAVY | {"stiffening"},
    ),
    "hum": Fault(lambda d: {"hum_nm": d.sized(0.02, 0.04, d.moment_nm)}),
    "cogging": Fault(lambda d: {"ripple_nm": d.sized(0.02, 0.04, d.moment_nm), "ripple_per_turn": d.uniform(9, 16)}),
    "wear": Fault(
        lambda d: {"friction_nm": _joint_friction(d, 0.004, 0.008, 1.5), "wear": 0.05},
        near=_one({"coulomb_friction", "damping", "drag"}),
    ),
}

# Arms: chains with motors, whose faults are larger next to the motors' torques.

_SHARED_WITH_CHAIN = ("damping", "drag", "lean", "bias", "payload", "hum", "kink", "cogging")
_ARM = {name: _CHAIN[name] for name in _SHARED_WITH_CHAIN} | {
    "coulomb_friction": Fault(
        lambda d: {"friction_nm": _joint_friction(d, 0.05, 0.1)}, _one({"coulomb_friction"}), _one({"stiction"})
    ),
    "weak motor": Fault(lambda d: {"strength": d.sized(0.1, 0.2, -1.0)}, _one({"gain"})),
    "offset": Fault(
        lambda d: {"offset_nm": d.either_way(0.05, 0.1, d.moment_nm)}, _one({"force_offset", "torque_offset"})
    ),
    "dead_time": Fault(
        lambda d: {"delay_s": d.sized(0.06, 0.1, d.pace_s) + d.size / d.rig.rate_hz},
        _one({"dead_time"}),
        _one({"latency"}),
    ),
    "wear": Fault(
        lambda d: {"friction_nm": _joint_friction(d, 0.05, 0.1, 1.5), "wear": 0.05},
        near=_one({"coulomb_friction", "damping"}),
    ),
}

_POSITION_ONLY = ("rate_limit", "load", "backlash", "hysteresis", "slipping", "stick-slip", "wear")
# A velocity axis follows with its velocity, so an acceleration limit is a rate limit there.
_VELOCITY_LIMIT = Fault(lambda d: {"acceleration": _rate(d)}, _one({"acceleration_limit", "rate_limit"}))
FAULTS: Final[Mapping[Plant, Mapping[str, Fault]]] = {
    "velocity axis": {name: fault for name, fault in _FOLLOWER.items() if name not in _POSITION_ONLY}
    | {"acceleration_limit": _VELOCITY_LIMIT},
    "position axis": _FOLLOWER,
    "chamber": _CHAMBER,
    "cart": _CART,
    "pendulum": _CHAIN,
    "arm": _ARM,
    "cart-pendulum": _CHAIN,
}
