"""Model of a cart, or of any mass driven by a force: two bodies, a spring, direction-dependent friction, a slope.

A controller keeps the cart near a path during a recording; the force that it requests is recorded.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from validation.rigs.laws import GRAVITY_M_S2, Array, Bristles, Play, grown, lanes_of, worn

# Share of the mass behind the spring.
LOAD_SHARE = 0.35
SPRING_ZETA = 0.05

DEFAULTS: Mapping[str, float] = {
    "mass_kg": 1.0,
    "gain": 0.0,  # relative error of the motor's force constant
    "delay_s": 0.0,
    "lag_s": 0.0,  # lag of the current loop
    "friction_up_n": 0.0,
    "friction_down_n": 0.0,
    "viscous_n_s_m": 0.0,
    "drag_n_s2_m2": 0.0,
    "slope_rad": 0.0,
    "force_n": 0.0,  # constant force
    "spring_rad_s": 0.0,  # natural frequency of the load on its spring; 0: rigid
    "gap_m": 0.0,  # play between cart and encoder
    "ripple_n": 0.0,
    "ripple_pitch_m": 0.03,
    "hum_n": 0.0,  # amplitude of a force at 1 Hz
    "bumper_n_m": 0.0,  # stiffness of a spring that acts beyond `bumper_m`
    "bumper_m": 0.0,
    "drift": 0.0,  # share of the motor's force that is lost after a long time
    "wear": 0.0,  # share of the friction that is present at first; 0: all
}


@dataclass(frozen=True, slots=True)
class Controller:
    """Settings of the recording controller: critically damped, with the given mass."""

    mass_kg: float
    corner_rad_s: float
    force_max_n: float
    encoder_step_m: float


def cart(
    path: Array,
    lanes: Sequence[Mapping[str, float]],
    clock_s: Array,
    dt_s: float,
    each: int,
    controller: Controller,
    window_s: float = math.inf,
) -> tuple[Array, Array]:
    """Simulate carts in parallel lanes; return positions, m [N, L], and requested forces, N [S, K].

    N: steps, L: lanes, K: trials, S: samples of `each` steps. The lanes are variants of K trials. The first K lanes are
    the recorded ones; the others receive the same forces.

    Args:
        path: Positions that the carts follow, m [N, K].
        lanes: Parameters of each lane by the names in `DEFAULTS`.
        clock_s: Start time of each lane in its campaign, s [L].
        each: Steps per sample.
        window_s: Period after which all variants are reset to the position and speed of the recorded lanes.

    Raises:
        KeyError: A name is not in `DEFAULTS`.
    """
    p = lanes_of("a cart", lanes, DEFAULTS)
    trials = path.shape[1]
    copies = len(lanes) // trials
    of = np.tile(np.arange(trials), copies)
    springs = p["spring_rad_s"] > 0
    sprung = bool(springs.any())
    mass = np.where(springs, (1 - LOAD_SHARE) * p["mass_kg"], p["mass_kg"])
    load = LOAD_SHARE * p["mass_kg"]
    stiff, damp = load * p["spring_rad_s"] ** 2, 2 * SPRING_ZETA * load * p["spring_rad_s"]
    share = worn(p, clock_s)
    top = float(np.max(np.abs(path - path[0]))) or 1.0
    rub = Bristles(p["friction_up_n"] * share, p["friction_down_n"] * share, mass, 2e-4 * top, dt_s)
    x = np.tile(path[0], copies)
    v, y, w, force = np.zeros_like(x), x.copy(), np.zeros_like(x), np.zeros_like(x)
    play = Play(p["gap_m"], x)
    late = np.floor(p["delay_s"] / dt_s).astype(int)
    rest = p["delay_s"] / dt_s - late  # share of a step during which the previous force still acts
    lag = np.maximum(p["lag_s"], 1e-9)
    follows = 1 - np.exp(-dt_s / lag)
    weight = p["mass_kg"] * GRAVITY_M_S2 * np.sin(p["slope_rad"]) + p["force_n"]
    asked = np.zeros((len(path) // each + 1, trials))
    out, last = np.empty((len(path), len(lanes))), np.round(path[0] / controller.encoder_step_m)
    window = max(round(window_s / dt_s), 1) if math.isfinite(window_s) else len(path) + 1
    speed, kept = np.zeros(trials), math.exp(-4 * controller.corner_rad_s * each * dt_s)
    for i in range(len(path)):
        t = i * dt_s
        if i % window == 0:
            for state in (x, v, y, w, force, rub.bend):
                state.reshape(copies, trials)[:] = state[:trials]
        if i % each == 0:
            counts = np.round(x[:trials] / controller.encoder_step_m)
            speed = kept * speed + (1 - kept) * (counts - last) * controller.encoder_step_m / (each * dt_s)
            last = counts
            asked[i // each] = _requested_force(
                controller, path, i, each * dt_s, each, counts * controller.encoder_step_m, speed
            )
        out[i] = play.step(x)
        received = (1 - rest) * _received(asked, i - late, each, of) + rest * _received(asked, i - late - 1, each, of)
        strong = (1 + p["gain"]) * (1 - p["drift"] * grown(clock_s + t))
        wanted = received * strong
        behind = (force - wanted) * follows
        force -= behind
        mean = wanted + behind * lag / dt_s  # over the step
        push = mean + weight - p["viscous_n_s_m"] * v - p["drag_n_s2_m2"] * v * np.abs(v)
        push += p["ripple_n"] * np.sin(2 * np.pi * x / p["ripple_pitch_m"])
        push += p["hum_n"] * np.sin(2 * np.pi * (clock_s + t))
        push -= p["bumper_n_m"] * np.maximum(x - p["bumper_m"], 0.0)
        if rub.any:
            push -= rub.force(v)
        if sprung:
            pull = np.where(springs, stiff * (x - y) + damp * (v - w), 0.0)
            w += dt_s * pull / np.maximum(load, 1e-12)
            y += dt_s * w
            push -= pull
        v += dt_s * push / mass
        x += dt_s * (v - dt_s * push / mass / 2)  # exact for a constant force
        if not sprung:
            y[:] = x
    return out, asked


def _received(asked: Array, step: NDArray[np.int_], each: int, of: NDArray[np.int_]) -> Array:
    """Return the force of each lane that was requested at a step, N [L]; 0 before the first."""
    return np.where(step < 0, 0.0, asked[np.maximum(step, 0) // each, of])


def _requested_force(
    controller: Controller, path: Array, i: int, step_s: float, each: int, measured: Array, speed: Array
) -> Array:
    """Return the force that the controller requests, N."""
    # Speed and acceleration are constant at both ends of the path.
    inside = min(max(i, each), len(path) - 1 - each)
    before, here, after = path[inside - each], path[inside], path[inside + each]
    wanted_speed = (after - before) / (2 * step_s)
    wanted_push = (after - 2 * here + before) / step_s**2
    c = controller.corner_rad_s
    force = controller.mass_kg * (wanted_push + 2 * c * (wanted_speed - speed) + c * c * (path[i] - measured))
    return np.asarray(np.minimum(np.maximum(force, -controller.force_max_n), controller.force_max_n))
