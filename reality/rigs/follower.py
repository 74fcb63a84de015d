"""What follows a command: an axis in velocity or position mode, a servo; and a chamber behind a valve.

A lane's numbers are a mapping; what a lane does not say is neutral (`DEFAULTS`). Positions, speeds and forces are in
the rig's own length (a radian, a metre) and per mass.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from softarm.reality.rigs.laws import Array, Bristles, Loops, Play, orifice, sheared, stacked

INF = float("inf")
INNER_SHARE = 1 / 40  # of the outer loop's time: what the inner loop takes
ATMOSPHERE_KPA = 101.3

DEFAULTS: Mapping[str, float] = {
    "lag_s": 0.1,  # of the outer loop: 1 / its gain
    "lag_down_s": 0.0,  # of a chamber that empties; 0: the same
    "gain": 0.0,  # of the command that the loop is given
    "offset": 0.0,
    "ceiling": INF,  # of the command or the supply
    "dead_zone": 0.0,  # of the loop's error
    "rate": INF,  # of what is followed
    "acceleration": INF,
    "friction_up": 0.0,  # per mass
    "friction_down": 0.0,
    "stiction": 1.0,
    "stribeck": 1.0,
    "load": 0.0,  # a steady force, per mass
    "gap": 0.0,
    "loop_width": 0.0,
    "mode_rad_s": 0.0,  # of a spring between what is driven and what is seen; 0: none
    "mode_zeta": 0.15,
    "ripple": 0.0,  # a force that repeats with the position, per mass
    "ripple_pitch": 1.0,
    "hum": 0.0,  # of 1 Hz, on what is seen
    "drift": 0.0,  # share by which the gain has grown after a long time
    "drift_s": 60.0,
    "wear": 0.0,  # share of the play or friction that is there at first; 0: all
    "wear_s": 60.0,
    "slip": 0.0,  # lost at once when it is driven hard
    "slip_above": INF,  # acceleration
    "orifice_1_s": INF,  # of a chamber: how fast a wide open valve fills it, in upstream pressures
    "supply_kpa": 400.0,  # gauge
}
NAMES: frozenset[str] = frozenset(DEFAULTS)


def lanes_of(lanes: Sequence[Mapping[str, float]]) -> dict[str, Array]:
    """Numbers of all lanes, an array a name. Raises KeyError for a name that no lane can have."""
    unknown = {name for lane in lanes for name in lane} - NAMES
    if unknown:
        raise KeyError(f"no such number of a follower: {', '.join(sorted(unknown))}")
    return {name: stacked([lane.get(name, value) for lane in lanes]) for name, value in DEFAULTS.items()}


class _Seen:
    """From what is driven to what a sensor would touch: spring, play, hysteresis, slip, hum."""

    def __init__(self, p: Mapping[str, Array], start: Array, clock_s: Array, dt_s: float) -> None:
        self._p, self._clock_s, self._dt_s = p, clock_s, dt_s
        self._springs = p["mode_rad_s"] > 0
        self._at, self._speed = start.copy(), np.zeros_like(start)
        self._play = Play(p["gap"] * worn(p, clock_s), start)
        self._loops = Loops(p["loop_width"], start)
        self._lost = np.zeros_like(start)
        self._last = np.zeros_like(start)
        self._slips = bool(np.any(p["slip"] != 0))
        self._recovered = np.zeros_like(start)

    def step(self, x: Array, push: Array, t_s: float) -> Array:
        p, dt = self._p, self._dt_s
        if np.any(self._springs):
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


def worn(p: Mapping[str, Array], clock_s: Array) -> Array:
    """Share of play or friction that is there by now: it grows from `wear` of it."""
    grown = p["wear"] + (1 - p["wear"]) * (1 - np.exp(-clock_s / p["wear_s"]))
    return np.where(p["wear"] > 0, grown, 1.0)


def axis(commands: Array, lanes: Sequence[Mapping[str, float]], clock_s: Array, dt_s: float, velocity: bool) -> Array:
    """[N, L] where (or, in velocity mode, how fast) each lane is, from [N, L] commands as they arrive.

    Position mode: a proportional loop around a velocity loop that is 40 times as quick; velocity mode: a proportional
    loop around a current loop. clock_s: [L] when each lane's trial began in the campaign.
    """
    p = lanes_of(lanes)
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
        scale = 1 + p["gain"] + p["drift"] * (1 - np.exp(-(clock_s + t) / p["drift_s"]))
        wanted = np.minimum(commands[i] * scale + p["offset"], p["ceiling"])
        if velocity:
            push = sheared(wanted - v, p["dead_zone"]) / outer
            push = np.minimum(np.maximum(push, -p["acceleration"]), p["acceleration"])
            f += (push - f) * dt_s / inner
            force = f
        else:
            speed = sheared(wanted - x, p["dead_zone"]) / outer
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
    """[N, L] gauge pressure, kPa, of each lane's chamber, from [N, L] commands (kPa) as they arrive.

    A regulator opens its valve as far as the pressure's error asks, by a map of the valve that is right for the flow
    through it; wide open it passes what the orifice does, from a supply or to the room. The spool takes a
    fortieth of the lag.
    """
    p = lanes_of(lanes)
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
        scale = 1 + p["gain"] + p["drift"] * (1 - np.exp(-(clock_s + t) / p["drift_s"]))
        wanted = np.minimum(commands[i] * scale + p["offset"], p["ceiling"])
        error = sheared(wanted - pressure, p["dead_zone"])
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
    """Bristles bend by a hundredth of the error that their friction holds up."""
    level = np.maximum(p["friction_up"], p["friction_down"])
    return np.maximum(0.01 * level * outer * inner, 1e-9)
