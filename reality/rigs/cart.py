"""A cart on a rail, or any mass that is driven by a force: two bodies and a spring, friction each way, a slope.

Whoever records such a rig holds it near a path by a controller of their own; the force that it asked for is recorded.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from softarm.reality.rigs.laws import Array, Bristles, Play, stacked

GRAVITY_M_S2 = 9.81
LOAD_SHARE = 0.35  # of the mass, behind the spring

DEFAULTS: Mapping[str, float] = {
    "mass_kg": 1.0,
    "gain": 0.0,  # share by which the motor is stronger than its force constant says
    "delay_s": 0.0,
    "lag_s": 0.0,  # of the current loop
    "friction_up_n": 0.0,
    "friction_down_n": 0.0,
    "stiction": 1.0,
    "stribeck_m_s": 1.0,
    "viscous_n_s_m": 0.0,
    "drag_n_s2_m2": 0.0,
    "slope_rad": 0.0,
    "force_n": 0.0,  # steady
    "spring_rad_s": 0.0,  # of the load on its spring; 0: stiff
    "spring_zeta": 0.05,
    "gap_m": 0.0,  # between cart and what the encoder sees
    "ripple_n": 0.0,
    "ripple_pitch_m": 0.03,
    "hum_n": 0.0,  # of 1 Hz
    "bumper_n_m": 0.0,  # a spring that is met beyond a place
    "bumper_m": 0.0,
    "drift": 0.0,  # share that the motor's strength has lost after a long time
    "drift_s": 60.0,
    "wear": 0.0,  # share of the friction that is there at first; 0: all
    "wear_s": 60.0,
}


@dataclass(frozen=True, slots=True)
class Held:
    """The controller of whoever records: critically damped, and told the mass."""

    mass_kg: float
    corner_rad_s: float
    most_n: float
    resolution_m: float  # of the encoder that it reads


def cart(
    path: Array,
    lanes: Sequence[Mapping[str, float]],
    clock_s: Array,
    dt_s: float,
    each: int,
    held: Held,
    window_s: float = math.inf,
) -> tuple[Array, Array]:
    """[N, L] positions, m, and [S, K] forces that were asked for, N, in K trials with S samples of `each` steps.

    path: [N, K] where the carts are to go. Lanes come as variants of K trials: the first K are the recorded ones, the
    others feel the same forces; every `window_s` they are put where the recorded ones are, with their speed.
    Raises KeyError for a number that no cart has.
    """
    unknown = {name for lane in lanes for name in lane} - DEFAULTS.keys()
    if unknown:
        raise KeyError(f"no such number of a cart: {', '.join(sorted(unknown))}")
    p = {name: stacked([lane.get(name, value) for lane in lanes]) for name, value in DEFAULTS.items()}
    trials = path.shape[1]
    copies = len(lanes) // trials
    of = np.tile(np.arange(trials), copies)
    springs = p["spring_rad_s"] > 0
    mass = np.where(springs, (1 - LOAD_SHARE) * p["mass_kg"], p["mass_kg"])
    load = LOAD_SHARE * p["mass_kg"]
    stiff, damp = load * p["spring_rad_s"] ** 2, 2 * p["spring_zeta"] * load * p["spring_rad_s"]
    worn = np.where(p["wear"] > 0, p["wear"] + (1 - p["wear"]) * (1 - np.exp(-clock_s / p["wear_s"])), 1.0)
    top = float(np.max(np.abs(path - path[0]))) or 1.0
    rub = Bristles(
        p["friction_up_n"] * worn, p["friction_down_n"] * worn, mass, 2e-4 * top, dt_s, p["stiction"], p["stribeck_m_s"]
    )
    x = np.tile(path[0], copies)
    v, y, w, force = np.zeros_like(x), x.copy(), np.zeros_like(x), np.zeros_like(x)
    play = Play(p["gap_m"], x)
    late = np.round(p["delay_s"] / dt_s).astype(int)
    follows = np.where(p["lag_s"] > 0, 1 - np.exp(-dt_s / np.maximum(p["lag_s"], 1e-9)), 1.0)
    weight = p["mass_kg"] * GRAVITY_M_S2 * np.sin(p["slope_rad"]) + p["force_n"]
    asked = np.zeros((len(path) // each + 1, trials))
    out, last = np.empty((len(path), len(lanes))), np.round(path[0] / held.resolution_m)
    window = max(round(window_s / dt_s), 1) if math.isfinite(window_s) else len(path) + 1
    speed, kept = np.zeros(trials), math.exp(-4 * held.corner_rad_s * each * dt_s)
    for i in range(len(path)):
        t = i * dt_s
        if i % window == 0:
            for state in (x, v, y, w, force, rub.bend):
                state.reshape(copies, trials)[:] = state[:trials]
        if i % each == 0:
            counts = np.round(x[:trials] / held.resolution_m)
            speed = kept * speed + (1 - kept) * (counts - last) * held.resolution_m / (each * dt_s)
            last = counts
            asked[i // each] = _asked(held, path, i, each * dt_s, each, counts * held.resolution_m, speed)
        heard = asked[np.maximum(i - late, 0) // each, of]
        heard = np.where(late > i, 0.0, heard)
        strong = (1 + p["gain"]) * (1 - p["drift"] * (1 - np.exp(-(clock_s + t) / p["drift_s"])))
        force += (heard * strong - force) * follows
        push = force + weight - p["viscous_n_s_m"] * v - p["drag_n_s2_m2"] * v * np.abs(v)
        push += p["ripple_n"] * np.sin(2 * np.pi * x / p["ripple_pitch_m"])
        push += p["hum_n"] * np.sin(2 * np.pi * (clock_s + t))
        push -= p["bumper_n_m"] * np.maximum(x - p["bumper_m"], 0.0)
        if rub.any:
            push -= rub.force(v)
        if np.any(springs):
            pull = np.where(springs, stiff * (x - y) + damp * (v - w), 0.0)
            w += dt_s * pull / np.maximum(load, 1e-12)
            y += dt_s * w
            push -= pull
        v += dt_s * push / mass
        x += dt_s * v
        if not np.any(springs):
            y[:] = x
        out[i] = play.step(x)
    return out, asked


def _asked(held: Held, path: Array, i: int, step_s: float, each: int, seen: Array, speed: Array) -> Array:
    """What the controller asks of the motor, N."""
    inside = min(max(i, each), len(path) - 1 - each)  # at its ends the path goes on as it does there
    before, here, after = path[inside - each], path[inside], path[inside + each]
    wanted_speed = (after - before) / (2 * step_s)
    wanted_push = (after - 2 * here + before) / step_s**2
    c = held.corner_rad_s
    force = held.mass_kg * (wanted_push + 2 * c * (wanted_speed - speed) + c * c * (path[i] - seen))
    return np.asarray(np.clip(force, -held.most_n, held.most_n))
