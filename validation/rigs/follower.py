"""Models of rigs that follow a command: an axis in velocity or position mode, a servo, a chamber behind a valve.

A mapping gives the parameters of each lane; missing ones are neutral (`DEFAULTS`). Positions, speeds and forces are
per mass and in the rig's own unit of length (radian or metre).
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from validation.rigs.laws import Array, Bristles, Loops, Play, dead_zone, grown, lanes_of, orifice, worn

INF = float("inf")
# Time constant of the inner loop as a share of the outer loop's.
INNER_SHARE = 1 / 40
LONGER_SHARE = (1 + math.sqrt(1 - 4 * INNER_SHARE)) / 2  # of a lag in the two loops: their longer time constant
ATMOSPHERE_KPA = 101.3

DEFAULTS: Mapping[str, float] = {
    "lag_s": 0.1,  # time constant of the outer loop
    "lag_down_s": 0.0,  # time constant of venting a chamber; 0: `lag_s`
    "gain": 0.0,  # relative error of the command
    "offset": 0.0,
    "ceiling": INF,  # upper limit of the command or the supply
    "dead_zone": 0.0,  # dead zone of the loop's error
    "rate": INF,  # limit of the speed
    "acceleration": INF,
    # Friction and forces are per mass.
    "friction_up": 0.0,
    "friction_down": 0.0,
    "stiction": 1.0,
    "stribeck": 1.0,
    "load": 0.0,  # constant force
    "gap": 0.0,
    "loop_width": 0.0,
    "mode_rad_s": 0.0,  # natural frequency of a spring between drive and sensor; 0: no spring
    "mode_zeta": 0.15,
    "ripple": 0.0,  # force that repeats with the position
    "ripple_pitch": 1.0,
    "hum": 0.0,  # amplitude of a 1 Hz error of the measurement
    "drift": 0.0,  # share by which the gain has grown after a long time
    "wear": 0.0,  # share of play or friction that is present at first; 0: all
    "slip": 0.0,  # position that is lost when the acceleration exceeds `slip_above`
    "slip_above": INF,
    "orifice_1_s": INF,  # fill rate of a chamber through a wide open valve, in upstream pressures
    "supply_kpa": 400.0,  # gauge pressure of the supply
}


class _Seen:
    """Path from the drive to the sensor: spring, play, hysteresis, slip, hum."""

    def __init__(self, p: Mapping[str, Array], start: Array, clock_s: Array, dt_s: float) -> None:
        self._p, self._clock_s, self._dt_s = p, clock_s, dt_s
        self._springs = p["mode_rad_s"] > 0
        self._sprung = bool(self._springs.any())
        self._at, self._speed = start.copy(), np.zeros_like(start)
        self._play = Play(p["gap"] * worn(p, clock_s), start)
        self._loops = Loops(p["loop_width"], start)
        self._lost = np.zeros_like(start)
        self._last = np.zeros_like(start)
        self._slips = bool(np.any(p["slip"] != 0))
        self._recovered = np.zeros_like(start)

    def step(self, x: Array, push: Array, t_s: float) -> Array:
        p, dt = self._p, self._dt_s
        if self._sprung:
            w, zeta = p["mode_rad_s"], p["mode_zeta"]
            moved = (x - self._last) / dt if t_s > 0 else np.zeros_like(x)
            self._speed += dt * (w * w * (x - self._at) + 2 * zeta * w * (moved - self._speed))
            self._at += dt * self._speed
            self._last = x.copy()
            x = np.where(self._springs, self._at, x)
        if self._slips:
            hit = (np.abs(push) > p["slip_above"]) & (t_s > self._recovered)
            self._lost -= np.where(hit, p["slip"] * np.sign(push), 0.0)
            self._recovered = np.where(hit, t_s + 0.5, self._recovered)
            x = x + self._lost
        x = self._loops.step(self._play.step(x))
        return np.asarray(x + p["hum"] * np.sin(2 * np.pi * (self._clock_s + t_s) + 0.7))


def axis(commands: Array, lanes: Sequence[Mapping[str, float]], clock_s: Array, dt_s: float, velocity: bool) -> Array:
    """Return the positions or, in velocity mode, the speeds [N, L] for received commands [N, L].

    Position mode: a proportional loop around a velocity loop that is 40 times as fast. Velocity mode: a proportional
    loop around a current loop.

    Args:
        clock_s: Start time of each lane's trial in the campaign, s [L].
    """
    p = lanes_of("a follower", lanes, DEFAULTS)
    n = commands.shape[1]
    outer, inner = p["lag_s"], INNER_SHARE * p["lag_s"]
    start = commands[0].copy()
    x, v, f = (np.zeros(n) if velocity else start.copy()), (start.copy() if velocity else np.zeros(n)), np.zeros(n)
    share = worn(p, clock_s)
    rub = Bristles(
        p["friction_up"] * share, p["friction_down"] * share, 1.0, _give(p, outer, inner), dt_s,
        p["stiction"], p["stribeck"],
    )  # fmt: skip
    seen = _Seen(p, v if velocity else x, clock_s, dt_s)
    out = np.empty_like(commands)
    waves = np.any(p["ripple"] != 0)
    for i in range(len(commands)):
        t = i * dt_s
        scale = 1 + p["gain"] + p["drift"] * grown(clock_s + t)
        wanted = np.minimum(commands[i] * scale + p["offset"], p["ceiling"])
        if velocity:
            push = dead_zone(wanted - v, p["dead_zone"]) / outer
            push = np.minimum(np.maximum(push, -p["acceleration"]), p["acceleration"])
            f += (push - f) * dt_s / inner
            force = f
        else:
            speed = dead_zone(wanted - x, p["dead_zone"]) / outer
            speed = np.minimum(np.maximum(speed, -p["rate"]), p["rate"])
            push = (speed - v) / inner
            force = push = np.minimum(np.maximum(push, -p["acceleration"]), p["acceleration"])
        pushed = force + p["load"]
        if waves:
            pushed = pushed + p["ripple"] * np.sin(2 * np.pi * x / p["ripple_pitch"])
        if rub.any:
            pushed = pushed - rub.force(v)
        v = v + dt_s * pushed
        x = x + dt_s * v
        out[i] = seen.step(v if velocity else x, push, t)
    return out


def chamber(commands: Array, lanes: Sequence[Mapping[str, float]], clock_s: Array, dt_s: float) -> Array:
    """Return the gauge pressure of each lane's chamber, kPa [N, L], for received commands, kPa [N, L].

    A regulator opens its valve in proportion to the pressure error, through an exact map of the valve's flow. When
    wide open, the orifice limits the flow from the supply or to the atmosphere. The spool has 1/40 of the lag.
    """
    p = lanes_of("a follower", lanes, DEFAULTS)
    fill = p["lag_s"]
    vent = np.where(p["lag_down_s"] > 0, p["lag_down_s"], fill)
    pressure = commands[0].copy()
    opening = np.zeros_like(pressure)
    supply = p["supply_kpa"] + ATMOSPHERE_KPA
    wide = np.where(np.isfinite(p["orifice_1_s"]), p["orifice_1_s"], 30.0 / fill)
    seen = _Seen(p, pressure, clock_s, dt_s)
    out = np.empty_like(commands)
    for i in range(len(commands)):
        t = i * dt_s
        scale = 1 + p["gain"] + p["drift"] * grown(clock_s + t)
        wanted = np.minimum(commands[i] * scale + p["offset"], p["ceiling"])
        error = dead_zone(wanted - pressure, p["dead_zone"])
        inside = pressure + ATMOSPHERE_KPA
        inward = wide * orifice(supply, inside)
        outward = wide * orifice(inside, np.full_like(inside, ATMOSPHERE_KPA))
        rising = error > 0
        asked = error / np.where(rising, fill, vent)
        most = np.where(rising, inward, outward)
        share = np.clip(asked / np.maximum(most, 1e-9), -1.0, 1.0)
        opening += (share - opening) * np.minimum(dt_s / (INNER_SHARE * np.minimum(fill, vent)), 1.0)
        flow = np.where(opening > 0, opening * inward, opening * outward)
        pressure = pressure + dt_s * flow
        out[i] = seen.step(pressure, flow, t)
    return out


def _give(p: Mapping[str, Array], outer: Array, inner: Array) -> Array:
    """Return the deflection of the bristles: a hundredth of the error that their friction holds."""
    level = np.maximum(p["friction_up"], p["friction_down"])
    return np.maximum(0.01 * level * outer * inner, 1e-9)
