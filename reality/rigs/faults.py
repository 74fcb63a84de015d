"""What can be wrong with a machine, how large, and what of it a diagnosis may say.

A fault is drawn for a rig from its own scales; `size` is 1 for what an owner would notice and 0.5 for half of it.
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
    """One thing that is wrong: how it is drawn, and which names are right for it."""

    draw: Draw
    names: frozenset[str] = frozenset()  # any of these is right; empty: outside the vocabulary
    tied: frozenset[str] = frozenset()  # may stand beside, as what the data cannot tell from it
    near: frozenset[str] = frozenset()  # of one outside: what may be said of it as a part (incomplete)
    also: frozenset[str] = frozenset()  # an effect that comes with it and is named beside it


def _share(random: np.random.Generator, low: float, high: float) -> float:
    return math.exp(random.uniform(math.log(low), math.log(high)))


def _either(random: np.random.Generator) -> float:
    return float(random.choice((-1.0, 1.0)))


def _late(rig: Rig, size: float, random: np.random.Generator) -> float:
    return size * max(_share(random, 0.35, 0.6) * rig.pace_s, 2.0 / rig.rate_hz)


def _lag(rig: Rig, size: float, random: np.random.Generator) -> Patch:
    factor = 1 + size * _share(random, 0.45, 0.8)
    return {"lag_s": rig.pace_s * (factor if random.random() < 0.7 else 1 / factor)}


def _ripple(rig: Rig, size: float, random: np.random.Generator) -> Patch:
    """Cogging: of an error of so much, and a few turns within the reach."""
    if rig.plant == "velocity axis":
        return {"ripple": size * _share(random, 0.06, 0.1) * rig.reach / rig.pace_s,
                "ripple_pitch": rig.reach * max(6 * rig.pace_s, 0.2)}  # fmt: skip
    held = size * _share(random, 0.04, 0.07) * rig.reach
    return {"ripple": held / (INNER_SHARE * rig.pace_s**2), "ripple_pitch": rig.reach / random.uniform(2.0, 4.0)}


def _friction(rig: Rig, size: float, random: np.random.Generator) -> float:
    """Per mass: what holds a few hundredths of the reach as an error."""
    held = size * _share(random, 0.04, 0.07) * rig.reach
    return held / rig.pace_s if rig.plant == "velocity axis" else held / (INNER_SHARE * rig.pace_s**2)


def _mode(rig: Rig, size: float, random: np.random.Generator) -> Patch:
    # Half the size: twice as stiff, so half the way that the spring gives.
    w = _share(random, 1.3, 2.2) / rig.pace_s / math.sqrt(size)
    return {"mode_rad_s": w, "mode_zeta": random.uniform(0.12, 0.3)}


def _steady(rig: Rig, size: float, random: np.random.Generator) -> float:
    return _either(random) * size * _share(random, 0.05, 0.1) * rig.reach


def _each(joints: tuple[float, ...], share: float) -> tuple[float, ...]:
    """So much of each joint's."""
    return tuple(share * joint for joint in joints)


def _of_reach(low: float, high: float) -> Size:
    return lambda rig, size, random: size * _share(random, low, high) * rig.reach


def _follower() -> dict[str, Fault]:
    one = frozenset
    late, zero = one({"dead_time", "latency"}), one({"gain", "sensor_bias"})
    loose = one({"backlash", "hysteresis", "deadband"})
    gap, dead, loop = _of_reach(0.06, 0.1), _of_reach(0.05, 0.09), _of_reach(0.25, 0.4)
    fastest: Size = lambda r, s, g: _share(g, 0.22, 0.38) / s**0.7 * r.reach / r.pace_s  # noqa: E731
    return {
        "dead_time": Fault(lambda r, s, g: {"delay_s": _late(r, s, g)}, one({"dead_time"}), late),
        "latency": Fault(lambda r, s, g: {"late_s": _late(r, s, g)}, late),
        "lag": Fault(_lag, one({"lag"})),
        "rate_limit": Fault(lambda r, s, g: {"rate": fastest(r, s, g)}, one({"rate_limit"})),
        "acceleration_limit": Fault(
            lambda r, s, g: {"acceleration": _share(g, 0.5, 0.9) / s * r.reach / r.pace_s**2},
            one({"acceleration_limit"}),
        ),
        "deadband": Fault(lambda r, s, g: {"dead_zone": dead(r, s, g)}, one({"deadband"}), loose),
        "friction": Fault(
            lambda r, s, g: dict.fromkeys(("friction_up", "friction_down"), _friction(r, s, g)),
            one({"deadband", "coulomb_friction"}), loose,
        ),
        "gain": Fault(lambda r, s, g: {"gain": _either(g) * s * _share(g, 0.08, 0.15)}, one({"gain"}), zero),
        "offset": Fault(lambda r, s, g: {"offset": _steady(r, s, g)}, one({"gain"}), zero),
        "load": Fault(
            lambda r, s, g: {"load": _steady(r, s, g) / (INNER_SHARE * r.pace_s**2)},
            one({"gain", "force_offset"}), zero,
        ),
        "ceiling": Fault(
            lambda r, s, g: {"ceiling": r.centre + r.reach * (1 - s * g.uniform(0.45, 0.6))}, one({"ceiling"})
        ),
        "sensor_bias": Fault(lambda r, s, g: {"bias": _steady(r, s, g)}, zero),
        "backlash": Fault(lambda r, s, g: {"gap": gap(r, s, g)}, one({"backlash"}), loose),
        "hysteresis": Fault(lambda r, s, g: {"loop_width": loop(r, s, g)}, one({"hysteresis"}), one({"backlash"})),
        "second_order": Fault(_mode, one({"second_order"})),
        "cogging": Fault(_ripple),
        "stick-slip": Fault(
            lambda r, s, g: dict.fromkeys(("friction_up", "friction_down"), _friction(r, s, g))
            | {"stiction": g.uniform(2.5, 3.5), "stribeck": 0.1 * r.reach / max(r.pace_s, 0.1)},
            near=loose | {"coulomb_friction", "stiction"},
        ),
        "drifting gain": Fault(
            lambda r, s, g: {"drift": _either(g) * s * _share(g, 0.15, 0.25)}, near=one({"gain"})
        ),
        "slipping": Fault(
            lambda r, s, g: {"slip": s * g.uniform(0.04, 0.08) * r.reach,
                             "slip_above": g.uniform(0.5, 0.8) * r.reach / (INNER_SHARE * r.pace_s**2)},
        ),
        "hum": Fault(lambda r, s, g: {"hum": s * _share(g, 0.04, 0.07) * r.reach}),
        "wear": Fault(lambda r, s, g: {"gap": 1.6 * gap(r, s, g), "wear": 0.05}, near=loose),
    }  # fmt: skip


def _chamber() -> dict[str, Fault]:
    """A follower's, and what only air has."""
    shared = _follower()
    air = {name: shared[name] for name in (
        "dead_time", "latency", "lag", "deadband", "gain", "offset", "sensor_bias", "hysteresis", "second_order",
        "drifting gain", "hum",
    )}  # fmt: skip

    def uneven(rig: Rig, size: float, random: np.random.Generator) -> Patch:
        slow = 1 + size * _share(random, 0.7, 1.2)
        return {"lag_down_s": slow * rig.pace_s} if random.random() < 0.7 else {"lag_down_s": rig.pace_s / slow}

    def choked(rig: Rig, size: float, random: np.random.Generator) -> Patch:
        """Wide open, it fills a reach in a few of its times."""
        passes = 0.6 * (float(np.ravel(rig.numbers["supply_kpa"])[0]) + 101.3)
        return {"orifice_1_s": _share(random, 0.25, 0.4) / size**0.7 * rig.reach / rig.pace_s / passes}

    def starved(rig: Rig, size: float, random: np.random.Generator) -> Patch:
        return {"supply_kpa": rig.centre + rig.reach * (1 - size * random.uniform(0.45, 0.6))}

    return air | {
        "uneven lag": Fault(uneven, frozenset({"lag"})),
        "choked flow": Fault(choked, frozenset({"rate_limit"})),
        "weak supply": Fault(starved, frozenset({"ceiling"})),
    }


def force_of(rig: Rig) -> float:
    """What moves a cart or turns a chain's first joint, about: N or N m."""
    if rig.plant == "cart":
        return 0.6 * mass_of(rig) * rig.reach / rig.pace_s**2
    return moments_of(rig)[0]


def _speed_of(rig: Rig) -> float:
    """Of a cart, about."""
    return 0.7 * rig.reach / rig.pace_s


def _cart() -> dict[str, Fault]:
    one = frozenset
    scaled, pulled = one({"gain", "mass", "payload"}), one({"force_offset", "friction_asymmetry", "tilt"})
    rubs: Size = lambda r, s, g: s * _share(g, 0.1, 0.25) * force_of(r)  # noqa: E731

    def both(rig: Rig, size: float, random: np.random.Generator) -> Patch:
        return dict.fromkeys(("friction_up_n", "friction_down_n"), rubs(rig, size, random))

    def uneven(rig: Rig, size: float, random: np.random.Generator) -> Patch:
        level = rubs(rig, 1.0, random)
        return {"friction_up_n": level * (1 + 0.5 * size), "friction_down_n": level * (1 - 0.5 * size)}

    return {
        "coulomb_friction": Fault(both, one({"coulomb_friction"}), one({"stiction"})),
        "uneven friction": Fault(uneven, one({"friction_asymmetry"}), pulled, also=one({"coulomb_friction"})),
        "damping": Fault(lambda r, s, g: {"viscous_n_s_m": rubs(r, s, g) / _speed_of(r)}, one({"damping"})),
        "drag": Fault(lambda r, s, g: {"drag_n_s2_m2": 1.3 * rubs(r, s, g) / _speed_of(r) ** 2}, one({"drag"})),
        "slope": Fault(lambda r, s, g: {"force_n": _either(g) * rubs(r, s, g)}, one({"force_offset", "tilt"}), pulled),
        "payload": Fault(
            lambda r, s, g: {"mass_kg": mass_of(r) * (1 + s * _share(g, 0.15, 0.35))}, scaled
        ),
        "weak motor": Fault(lambda r, s, g: {"gain": -s * _share(g, 0.12, 0.25)}, scaled),
        "dead_time": Fault(lambda r, s, g: {"delay_s": 0.3 * _late(r, s, g)}, one({"dead_time"}), one({"latency"})),
        "lag": Fault(lambda r, s, g: {"lag_s": 0.3 * _late(r, s, g)}, one({"lag"}), one({"dead_time", "latency"})),
        "compliance": Fault(
            lambda r, s, g: {"spring_rad_s": _share(g, 5.0, 9.0) / r.pace_s / math.sqrt(s)},
            one({"compliance", "second_order"}),
        ),
        "backlash": Fault(lambda r, s, g: {"gap_m": s * _share(g, 0.03, 0.06) * r.reach}, one({"backlash"})),
        "cogging": Fault(lambda r, s, g: {"ripple_n": rubs(r, s, g), "ripple_pitch_m": r.reach / g.uniform(2.0, 4.0)}),
        "hum": Fault(lambda r, s, g: {"hum_n": rubs(r, s, g)}),
        "bumper": Fault(
            lambda r, s, g: {"bumper_n_m": 6 * rubs(r, s, g) / r.reach, "bumper_m": g.uniform(0.0, 0.3) * r.reach}
        ),
        "tiring motor": Fault(lambda r, s, g: {"drift": s * _share(g, 0.25, 0.4)}, near=scaled),
        "wear": Fault(lambda r, s, g: {**both(r, s, g), "wear": 0.05}, near=one({"coulomb_friction", "stiction"})),
    }  # fmt: skip


def _chain() -> dict[str, Fault]:
    one = frozenset
    lean, heavy = one({"sensor_bias", "tilt"}), one({"stiffness", "payload"})
    rubs: Size = lambda r, s, g: s * _share(g, 0.004, 0.008)  # noqa: E731

    def inertia(rig: Rig) -> float:
        mass, centre, own = (float(np.ravel(rig.numbers[k])[0]) for k in ("mass_kg", "centre_m", "inertia_kg_m2"))
        return mass * centre**2 + own

    def drag(rig: Rig, size: float, random: np.random.Generator) -> Patch:
        centre = float(np.ravel(rig.numbers["centre_m"])[0])
        return {"drag_n_s2_m2": size * _share(random, 0.04, 0.08) * inertia(rig) / centre**3}

    def last(rig: Rig) -> tuple[float, float]:
        return float(np.ravel(rig.numbers["mass_kg"])[-1]), float(np.ravel(rig.numbers["length_m"])[-1])

    return {
        "coulomb_friction": Fault(
            lambda r, s, g: {"friction_nm": _each(moments_of(r), rubs(r, s, g))},
            one({"coulomb_friction"}), one({"stiction"}),
        ),
        "damping": Fault(
            lambda r, s, g: {"viscous_nm_s": _each(damping_of(r), 1 + s * _share(g, 2.5, 4.0))},
            one({"damping"}),
        ),
        "drag": Fault(drag, one({"drag"})),
        "lean": Fault(lambda r, s, g: {"tilt_rad": _either(g) * s * _share(g, 0.03, 0.06)}, lean),
        "bias": Fault(lambda r, s, g: {"bias_rad": _either(g) * s * _share(g, 0.03, 0.06)}, lean),
        "moment": Fault(lambda r, s, g: {"moment": _either(g) * s * _share(g, 0.06, 0.12)}, one({"stiffness"}), heavy),
        "payload": Fault(
            lambda r, s, g: {"payload_kg": s * _share(g, 0.1, 0.2) * last(r)[0], "payload_m": last(r)[1]},
            one({"payload"}), heavy,
        ),
        "kink": Fault(
            lambda r, s, g: {"kink_nm_rad": s * _share(g, 0.2, 0.4) * moments_of(r)[0],
                             "kink_rad": g.uniform(0.03, 0.12)},
            near=heavy | {"stiffening"},
        ),
        "hum": Fault(lambda r, s, g: {"hum_nm": s * _share(g, 0.02, 0.04) * moments_of(r)[0]}),
        "cogging": Fault(
            lambda r, s, g: {"ripple_nm": s * _share(g, 0.02, 0.04) * moments_of(r)[0],
                             "ripple_per_turn": g.uniform(9, 16)},
        ),
        "wear": Fault(lambda r, s, g: {"friction_nm": _each(moments_of(r), 1.5 * rubs(r, s, g)), "wear": 0.05},
                      near=one({"coulomb_friction", "damping", "drag"})),
    }  # fmt: skip


def _arm() -> dict[str, Fault]:
    """A chain's with motors: all is larger beside their torques."""
    passive = _chain()
    keep = ("damping", "drag", "lean", "bias", "payload", "hum", "kink", "cogging")
    rubs: Size = lambda r, s, g: s * _share(g, 0.05, 0.1)  # noqa: E731
    return {name: passive[name] for name in keep} | {
        "coulomb_friction": Fault(
            lambda r, s, g: {"friction_nm": _each(moments_of(r), rubs(r, s, g))},
            frozenset({"coulomb_friction"}), frozenset({"stiction"}),
        ),
        "weak motor": Fault(lambda r, s, g: {"strength": -s * _share(g, 0.1, 0.2)}, frozenset({"gain"})),
        "offset": Fault(lambda r, s, g: {"offset_nm": _either(g) * rubs(r, s, g) * moments_of(r)[0]},
                        frozenset({"force_offset", "torque_offset"})),
        "dead_time": Fault(
            lambda r, s, g: {"delay_s": s * _share(g, 0.06, 0.1) * r.pace_s + s / r.rate_hz}, frozenset({"dead_time"}),
            frozenset({"latency"}),
        ),
        "wear": Fault(lambda r, s, g: {"friction_nm": _each(moments_of(r), 1.5 * rubs(r, s, g)), "wear": 0.05},
                      near=frozenset({"coulomb_friction", "damping"})),
    }  # fmt: skip


_FOLLOWER, _CART, _CHAIN = _follower(), _cart(), _chain()
_POSITION_ONLY = ("rate_limit", "load", "backlash", "hysteresis", "slipping", "stick-slip", "wear")
FAULTS: Final[Mapping[Plant, Mapping[str, Fault]]] = {
    "velocity axis": {name: f for name, f in _FOLLOWER.items() if name not in _POSITION_ONLY}
    | {
        "acceleration_limit": Fault(
            lambda r, s, g: {"acceleration": _share(g, 0.22, 0.38) / s**0.7 * r.reach / r.pace_s},
            frozenset({"acceleration_limit", "rate_limit"}),  # of what follows, its velocity: a rate
        )
    },
    "position axis": _FOLLOWER,
    "chamber": _chamber(),
    "cart": _CART,
    "pendulum": _CHAIN,
    "arm": _arm(),
    "cart-pendulum": _CHAIN,
}
