"""Faults of rigs: how they are drawn, and which names a diagnosis may give them.

A fault is drawn for a rig from its own scales; `size` is 1 for a fault that an owner notices and 0.5 for half of it.
Names are the registry's, without the stage.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from softarm.reality.rigs.follower import INNER_SHARE
from softarm.reality.rigs.presets import Plant, Rig, damping_of, mass_of, moments_of

Patch = Mapping[str, float | tuple[float, ...]]
Draw = Callable[[Rig, float, np.random.Generator], Patch]
Size = Callable[[Rig, float, np.random.Generator], float]


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault: its draw, and the names that are right for it."""

    draw: Draw
    names: frozenset[str] = frozenset()  # each of these is right; empty: outside the vocabulary
    tied: frozenset[str] = frozenset()  # may be listed too, as indistinguishable from it
    must: frozenset[str] = frozenset()  # must all be listed: the recordings of the case cannot distinguish them
    near: frozenset[str] = frozenset()  # of a fault outside: names of a part of it (verdict incomplete)
    also: frozenset[str] = frozenset()  # an effect that comes with it and is named as well


def _share(random: np.random.Generator, low: float, high: float) -> float:
    return math.exp(random.uniform(math.log(low), math.log(high)))


def _patch(**sizes: Size) -> Draw:
    """Return a draw of the named parameters, in their order."""
    return lambda rig, size, random: {name: draw(rig, size, random) for name, draw in sizes.items()}


def _sized(
    low: float, high: float, scale: Callable[[Rig], float] = lambda rig: 1.0, *, either_way: bool = False
) -> Size:
    """Return a draw of a share, low .. high, of a scale of the rig; with `either_way` of either sign."""

    def draw(rig: Rig, size: float, random: np.random.Generator) -> float:
        sign = float(random.choice((-1.0, 1.0))) if either_way else 1.0
        return sign * (size * _share(random, low, high) * scale(rig))

    return draw


def _uniform(low: float, high: float) -> Size:
    return lambda rig, size, random: random.uniform(low, high)


def _reach(rig: Rig) -> float:
    return rig.reach


def _first(rig: Rig, name: str) -> float:
    """Return a number of the rig, of its first link if there are several."""
    return float(np.ravel(rig.parameters[name])[0])


# Followers of commands: axes and chambers.


def _late(rig: Rig, size: float, random: np.random.Generator) -> float:
    return size * max(_share(random, 0.35, 0.6) * rig.pace_s, 2.0 / rig.rate_hz)


def _lag(rig: Rig, size: float, random: np.random.Generator) -> Patch:
    factor = 1 + size * _share(random, 0.45, 0.8)
    return {"lag_s": rig.pace_s * (factor if random.random() < 0.7 else 1 / factor)}


def _ripple(rig: Rig, size: float, random: np.random.Generator) -> Patch:
    """Draw cogging: its error, and a few periods within the reach."""
    if rig.plant == "velocity axis":
        ripple = size * _share(random, 0.06, 0.1) * rig.reach / rig.pace_s
        return {"ripple": ripple, "ripple_pitch": rig.reach * max(6 * rig.pace_s, 0.2)}
    held = size * _share(random, 0.04, 0.07) * rig.reach
    return {"ripple": held / (INNER_SHARE * rig.pace_s**2), "ripple_pitch": rig.reach / random.uniform(2.0, 4.0)}


def _friction(rig: Rig, size: float, random: np.random.Generator) -> Patch:
    """Draw dry friction a mass that holds an error of a few hundredths of the reach."""
    held = size * _share(random, 0.04, 0.07) * rig.reach
    level = held / rig.pace_s if rig.plant == "velocity axis" else held / (INNER_SHARE * rig.pace_s**2)
    return {"friction_up": level, "friction_down": level}


def _stick_slip(rig: Rig, size: float, random: np.random.Generator) -> Patch:
    friction = _friction(rig, size, random)
    return {**friction, "stiction": random.uniform(2.5, 3.5), "stribeck": 0.1 * rig.reach / max(rig.pace_s, 0.1)}


def _mode(rig: Rig, size: float, random: np.random.Generator) -> Patch:
    # Half the size: a spring that is twice as stiff, so it gives way by half.
    w = _share(random, 1.3, 2.2) / rig.pace_s / math.sqrt(size)
    return {"mode_rad_s": w, "mode_zeta": random.uniform(0.12, 0.3)}


def _rate(rig: Rig, size: float, random: np.random.Generator) -> float:
    return float(_share(random, 0.22, 0.38) / size**0.7 * rig.reach / rig.pace_s)


def _acceleration(rig: Rig, size: float, random: np.random.Generator) -> float:
    return _share(random, 0.5, 0.9) / size * rig.reach / rig.pace_s**2


_steady = _sized(0.05, 0.1, _reach, either_way=True)


def _load(rig: Rig, size: float, random: np.random.Generator) -> float:
    return _steady(rig, size, random) / (INNER_SHARE * rig.pace_s**2)


def _ceiling(rig: Rig, size: float, random: np.random.Generator) -> float:
    return rig.centre + rig.reach * (1 - size * random.uniform(0.45, 0.6))


def _slipping(rig: Rig, size: float, random: np.random.Generator) -> Patch:
    slip = size * random.uniform(0.04, 0.08) * rig.reach
    return {"slip": slip, "slip_above": random.uniform(0.5, 0.8) * rig.reach / (INNER_SHARE * rig.pace_s**2)}


_GAP = _sized(0.06, 0.1, _reach)


def _worn_gap(rig: Rig, size: float, random: np.random.Generator) -> Patch:
    return {"gap": 1.6 * _GAP(rig, size, random), "wear": 0.05}


_one = frozenset
_LATE, _ZERO = _one({"dead_time", "latency"}), _one({"gain", "sensor_bias"})
_LOOSE = _one({"backlash", "hysteresis", "deadband"})
_FOLLOWER = {
    "dead_time": Fault(_patch(delay_s=_late), _one({"dead_time"}), _LATE),
    "latency": Fault(_patch(late_s=_late), _LATE),
    "lag": Fault(_lag, _one({"lag"})),
    "rate_limit": Fault(_patch(rate=_rate), _one({"rate_limit"})),
    "acceleration_limit": Fault(_patch(acceleration=_acceleration), _one({"acceleration_limit"})),
    "deadband": Fault(_patch(dead_zone=_sized(0.05, 0.09, _reach)), _one({"deadband"}), _LOOSE),
    "friction": Fault(_friction, _one({"deadband", "coulomb_friction"}), _LOOSE),
    "gain": Fault(_patch(gain=_sized(0.08, 0.15, either_way=True)), _one({"gain"}), _ZERO),
    "offset": Fault(_patch(offset=_steady), _one({"gain"}), _ZERO),
    "load": Fault(_patch(load=_load), _one({"gain", "force_offset"}), _ZERO),
    "ceiling": Fault(_patch(ceiling=_ceiling), _one({"ceiling"})),
    "sensor_bias": Fault(_patch(bias=_steady), _ZERO),
    "backlash": Fault(_patch(gap=_GAP), _one({"backlash"}), _LOOSE),
    "hysteresis": Fault(_patch(loop_width=_sized(0.25, 0.4, _reach)), _one({"hysteresis"}), _one({"backlash"})),
    "second_order": Fault(_mode, _one({"second_order"})),
    "cogging": Fault(_ripple),
    "stick-slip": Fault(_stick_slip, near=_LOOSE | {"coulomb_friction", "stiction"}),
    "drifting gain": Fault(_patch(drift=_sized(0.15, 0.25, either_way=True)), near=_one({"gain"})),
    "slipping": Fault(_slipping),
    "hum": Fault(_patch(hum=_sized(0.04, 0.07, _reach))),
    "wear": Fault(_worn_gap, near=_LOOSE),
}


def _uneven_lag(rig: Rig, size: float, random: np.random.Generator) -> Patch:
    slow = 1 + size * _share(random, 0.7, 1.2)
    return {"lag_down_s": slow * rig.pace_s} if random.random() < 0.7 else {"lag_down_s": rig.pace_s / slow}


def _orifice(rig: Rig, size: float, random: np.random.Generator) -> float:
    """Draw an orifice; a wide open one fills a reach in a few of the rig's times."""
    passes = 0.6 * (_first(rig, "supply_kpa") + 101.3)
    return float(_share(random, 0.25, 0.4) / size**0.7 * rig.reach / rig.pace_s / passes)


_SHARED_WITH_CHAMBER = (
    *("dead_time", "latency", "lag", "deadband", "gain", "offset", "sensor_bias", "hysteresis", "second_order"),
    *("drifting gain", "hum"),
)


_CHAMBER = {name: _FOLLOWER[name] for name in _SHARED_WITH_CHAMBER} | {
    "uneven lag": Fault(_uneven_lag, _one({"lag"})),
    "choked flow": Fault(_patch(orifice_1_s=_orifice), _one({"rate_limit"})),
    "weak supply": Fault(_patch(supply_kpa=_ceiling), _one({"ceiling"})),
}


# Carts.


def _force_of(rig: Rig) -> float:
    """Return a typical force on a cart, N."""
    return 0.6 * mass_of(rig) * rig.reach / rig.pace_s**2


def _speed_of(rig: Rig) -> float:
    """Return a typical speed of a cart, m/s."""
    return 0.7 * rig.reach / rig.pace_s


_force = _sized(0.1, 0.25, _force_of)


def _even_friction(rig: Rig, size: float, random: np.random.Generator) -> Patch:
    return dict.fromkeys(("friction_up_n", "friction_down_n"), _force(rig, size, random))


def _uneven_friction(rig: Rig, size: float, random: np.random.Generator) -> Patch:
    level = _force(rig, 1.0, random)
    return {"friction_up_n": level * (1 + 0.5 * size), "friction_down_n": level * (1 - 0.5 * size)}


def _viscous(rig: Rig, size: float, random: np.random.Generator) -> float:
    return _force(rig, size, random) / _speed_of(rig)


def _cart_drag(rig: Rig, size: float, random: np.random.Generator) -> float:
    return 1.3 * _force(rig, size, random) / _speed_of(rig) ** 2


def _heavier(rig: Rig, size: float, random: np.random.Generator) -> float:
    return mass_of(rig) * (1 + size * _share(random, 0.15, 0.35))


def _soon(rig: Rig, size: float, random: np.random.Generator) -> float:
    return 0.3 * _late(rig, size, random)


def _spring(rig: Rig, size: float, random: np.random.Generator) -> float:
    return _share(random, 5.0, 9.0) / rig.pace_s / math.sqrt(size)


def _cart_cogging(rig: Rig, size: float, random: np.random.Generator) -> Patch:
    return {"ripple_n": _force(rig, size, random), "ripple_pitch_m": rig.reach / random.uniform(2.0, 4.0)}


def _bumper(rig: Rig, size: float, random: np.random.Generator) -> Patch:
    stiffness = 6 * _force(rig, size, random) / rig.reach
    return {"bumper_n_m": stiffness, "bumper_m": random.uniform(0.0, 0.3) * rig.reach}


def _worn_cart(rig: Rig, size: float, random: np.random.Generator) -> Patch:
    return {**_even_friction(rig, size, random), "wear": 0.05}


_SCALED, _PULLED = _one({"gain", "mass", "payload"}), _one({"force_offset", "friction_asymmetry", "tilt"})
_CART = {
    "coulomb_friction": Fault(_even_friction, _one({"coulomb_friction"}), _one({"stiction"})),
    "uneven friction": Fault(_uneven_friction, _one({"friction_asymmetry"}), _PULLED, also=_one({"coulomb_friction"})),
    "damping": Fault(_patch(viscous_n_s_m=_viscous), _one({"damping"})),
    "drag": Fault(_patch(drag_n_s2_m2=_cart_drag), _one({"drag"})),
    "slope": Fault(
        _patch(force_n=_sized(0.1, 0.25, _force_of, either_way=True)), _one({"force_offset", "tilt"}), _PULLED
    ),
    "payload": Fault(_patch(mass_kg=_heavier), _SCALED),
    "weak motor": Fault(_patch(gain=_sized(0.12, 0.25, lambda rig: -1.0)), _SCALED),
    "dead_time": Fault(_patch(delay_s=_soon), _one({"dead_time"}), _one({"latency"})),
    "lag": Fault(_patch(lag_s=_soon), _one({"lag"}), _one({"dead_time", "latency"})),
    "compliance": Fault(_patch(spring_rad_s=_spring), _one({"compliance", "second_order"})),
    "backlash": Fault(_patch(gap_m=_sized(0.03, 0.06, _reach)), _one({"backlash"})),
    "cogging": Fault(_cart_cogging),
    "hum": Fault(_patch(hum_n=_force)),
    "bumper": Fault(_bumper),
    "tiring motor": Fault(_patch(drift=_sized(0.25, 0.4)), near=_SCALED),
    "wear": Fault(_worn_cart, near=_one({"coulomb_friction", "stiction"})),
}


# Chains of links.


def _each(joints: tuple[float, ...], share: float) -> tuple[float, ...]:
    return tuple(share * joint for joint in joints)


def _moment(rig: Rig) -> float:
    return moments_of(rig)[0]


def _joint_friction(low: float, high: float, factor: float = 1.0, **further: float) -> Draw:
    """Return a draw of dry friction in every joint, with further parameters."""
    share = _sized(low, high)
    return lambda rig, size, random: {
        "friction_nm": _each(moments_of(rig), factor * share(rig, size, random)),
        **further,
    }


def _joint_damping(rig: Rig, size: float, random: np.random.Generator) -> Patch:
    return {"viscous_nm_s": _each(damping_of(rig), 1 + size * _share(random, 2.5, 4.0))}


def _chain_drag(rig: Rig, size: float, random: np.random.Generator) -> float:
    mass, centre, own = (_first(rig, name) for name in ("mass_kg", "centre_m", "inertia_kg_m2"))
    return size * _share(random, 0.04, 0.08) * (mass * centre**2 + own) / centre**3


def _tip_payload(rig: Rig, size: float, random: np.random.Generator) -> Patch:
    mass, length = (float(np.ravel(rig.parameters[name])[-1]) for name in ("mass_kg", "length_m"))
    return {"payload_kg": size * _share(random, 0.1, 0.2) * mass, "payload_m": length}


_LEAN, _HEAVY = _one({"sensor_bias", "tilt"}), _one({"stiffness", "payload"})
_CHAIN = {
    "coulomb_friction": Fault(_joint_friction(0.004, 0.008), _one({"coulomb_friction"}), _one({"stiction"})),
    "damping": Fault(_joint_damping, _one({"damping"})),
    "drag": Fault(_patch(drag_n_s2_m2=_chain_drag), _one({"drag"})),
    "lean": Fault(_patch(tilt_rad=_sized(0.03, 0.06, either_way=True)), _LEAN),
    "bias": Fault(_patch(bias_rad=_sized(0.03, 0.06, either_way=True)), _LEAN),
    # A mass at the tip slows the swing, so only a low moment resembles one.
    "moment": Fault(_patch(moment=_sized(0.06, 0.12)), _one({"stiffness"})),
    "low moment": Fault(_patch(moment=_sized(0.06, 0.12, lambda rig: -1.0)), _one({"stiffness"}), _HEAVY),
    "payload": Fault(_tip_payload, _one({"payload"}), _HEAVY),
    "kink": Fault(
        _patch(kink_nm_rad=_sized(0.2, 0.4, _moment), kink_rad=_uniform(0.03, 0.12)), near=_HEAVY | {"stiffening"}
    ),
    "hum": Fault(_patch(hum_nm=_sized(0.02, 0.04, _moment))),
    "cogging": Fault(_patch(ripple_nm=_sized(0.02, 0.04, _moment), ripple_per_turn=_uniform(9, 16))),
    "wear": Fault(_joint_friction(0.004, 0.008, 1.5, wear=0.05), near=_one({"coulomb_friction", "damping", "drag"})),
}


# Arms: chains with motors, whose faults are larger next to the motors' torques.


def _arm_delay(rig: Rig, size: float, random: np.random.Generator) -> float:
    return size * _share(random, 0.06, 0.1) * rig.pace_s + size / rig.rate_hz


_SHARED_WITH_CHAIN = ("damping", "drag", "lean", "bias", "payload", "hum", "kink", "cogging")
_ARM = {name: _CHAIN[name] for name in _SHARED_WITH_CHAIN} | {
    "coulomb_friction": Fault(_joint_friction(0.05, 0.1), _one({"coulomb_friction"}), _one({"stiction"})),
    "weak motor": Fault(_patch(strength=_sized(0.1, 0.2, lambda rig: -1.0)), _one({"gain"})),
    "offset": Fault(
        _patch(offset_nm=_sized(0.05, 0.1, _moment, either_way=True)), _one({"force_offset", "torque_offset"})
    ),
    "dead_time": Fault(_patch(delay_s=_arm_delay), _one({"dead_time"}), _one({"latency"})),
    "wear": Fault(_joint_friction(0.05, 0.1, 1.5, wear=0.05), near=_one({"coulomb_friction", "damping"})),
}

_POSITION_ONLY = ("rate_limit", "load", "backlash", "hysteresis", "slipping", "stick-slip", "wear")
# A velocity axis follows with its velocity, so an acceleration limit is a rate limit there.
_VELOCITY_LIMIT = Fault(_patch(acceleration=_rate), _one({"acceleration_limit", "rate_limit"}))
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
