"""Compiled law of one joint of a mechanism whose other joints follow their measured motion.

The rigid-body terms come from MuJoCo (`rigs/mjcf/mechanism.py`). A step is MuJoCo's semi-implicit Euler step with
implicit damping, so that a fitted value means the same in the model file. Dry friction holds a joint at rest, as real
friction does, or lets it creep, as MuJoCo's soft friction does (its documentation, Computation: Constraint model).

Several windows and points of a fit are simulated at once, each in one lane of a SIMD register.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
import functools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.view import Array
from softarm.simulator.compiled import compiler
from softarm.simulator.kernel.compiled import SOURCES
from softarm.simulator.kernel.numerics import clip
from softarm.simulator.simd import fill, load, magnitude, root, select, some, store

compiled = compiler(Path(__file__), *SOURCES)
# Functions of vectors become part of their caller.
inlined = functools.partial(compiled, forceinline=True)

# Columns of a law's parameters. Actuator: torque = clip(drive - KP x - KD v, LOW, HIGH), where errors of the position
# below WIDTH make no torque.
KP, KD, LOW, HIGH, WIDTH = range(5)
# Passive: viscous and quadratic friction, spring and its rest position, constant torque, error of the angle's zero.
VISCOUS, DRAG, SPRING, REST, OFFSET, BIAS = range(5, 11)
# Dry friction: sliding, more at rest, the speed at which that has faded, share of the torque in the gear, and the
# travel over which it bends before it slips.
DRY, STICTION, SPEED, LOADED, GIVE = range(11, 16)
# Play between the joint and its sensor; inertia besides the model's.
GAP, ARMATURE = range(16, 18)
# Soft friction: its softness per torque (MuJoCo's regulariser), and the rate at which it stops a joint, 1/s; 0 if hard.
SOFT, YIELDS = range(18, 20)
# Times by which the speeds in viscous friction and in the position loop are ahead, s, as in a simulation's long steps.
AHEAD, LOOP_AHEAD = range(20, 22)
# Friction in the gear: part of its share that belongs to the load, the speed at which it has faded, and whether viscous
# friction is the motor's own (1 or 0), which then brakes before the gear.
FROM_LOAD, LOAD_SPEED, BACK_EMF = range(22, 25)
COLUMNS = 25
# Damping of friction while it bends, as a share of the root of stiffness times inertia.
GRIP = 0.1
# Rows of a path: inertia, load at zero position and speed, its slopes by position and by speed.
INERTIA, LOAD, BY_POSITION, BY_SPEED = range(4)
ROWS = 4
# Residual of a simulation that diverged.
FAR = 1e3
# Lanes of a register.
LANES = (0.0,) * 8


class Windows(NamedTuple):
    """Measured windows of all trials, with M samples in W windows."""

    seen: Array  # [M] measured position; NaN where no sample was measured
    edges: NDArray[np.int64]  # [W + 1] first samples of the windows, and the end
    starts: Array  # [W, 2] position and speed at the starts
    sides: Array  # [W] place within the play, and bend of the friction, at the starts, -1 to 1
    step_s: Array  # [W] sampling intervals


class Inputs(NamedTuple):
    """Distinct inputs of P points, and the one of each point."""

    drives: Array  # [D, M each] drives of the actuator at each integration step
    drive_of: NDArray[np.int64]  # [P]
    paths: Array  # [B, ROWS, M] rigid-body terms at each sample
    path_of: NDArray[np.int64]  # [P]

    @classmethod
    def of(cls, drives: Sequence[Array], paths: Sequence[Array]) -> Self:
        """Return the inputs of P points, [M each] and [ROWS, M] of each; points may share an array."""
        return cls(*_distinct(drives), *_distinct(paths))


def _distinct(arrays: Sequence[Array]) -> tuple[Array, NDArray[np.int64]]:
    """Return the arrays without repeated objects, stacked, and the index of each one among them."""
    first = {id(array): array for array in arrays}
    places = {key: place for place, key in enumerate(first)}
    return np.stack([*first.values()]), np.array([places[id(array)] for array in arrays])


def residuals(windows: Windows, inputs: Inputs, laws: Array, each: int) -> Array:
    """Simulate every window from its guessed start; return measured minus predicted values at P points, [P, M].

    Args:
        windows: measured windows.
        inputs: drives and rigid-body terms of the points.
        laws: parameters of each point by the columns above, [P, COLUMNS].
        each: integration steps per sample.
    """
    out = np.empty((len(laws), len(windows.seen)))
    longest_first = np.argsort(-np.diff(windows.edges), kind="stable")
    _residuals(windows, longest_first, inputs, laws, each, LANES, out)
    return out


@inlined
def faded(x):
    """Return exp(-x) for x >= 0, to 1e-12: the 64th power of a series of x / 64."""
    y = 0.015625 * x
    grown = 1 / 720 + y * (1 / 5040 + y * (1 / 40320))
    grown = 1.0 + y * (1.0 + y * (1 / 2 + y * (1 / 6 + y * (1 / 24 + y * (1 / 120 + y * grown)))))
    fade = 1.0 / grown
    for _ in range(6):
        fade = fade * fade
    return fade


@inlined
def resisting(inertia, damping):
    """Return the inertia that gives the mean speed of a step the right damping, to second order and for any damping.

    That is z / (1 - exp(-z)) inertias for a damping z, here a fraction that is right at both ends; damping: in a step.
    """
    z = damping / inertia
    more = select(z > 0.0, z, 0.0)
    ratio = 1.0 + 0.5 * z + more * more / (12.0 + 2.0 * more)
    return inertia * select(ratio > 0.1, ratio, 0.1)


@inlined
def slide(v, bend, net, resists, inertia, dry, give, yields, h):
    """Return speed and bend of the friction after a step of h seconds.

    Args:
        v: speed.
        bend: share of the dry friction that is built up, -1 to 1.
        net: torque without dry friction.
        resists: inertia with the implicit part of the damping.
        inertia: inertia alone.
        dry: level of the dry friction.
        give: travel over which it builds up (elastoplastic, a Prandtl element); 0 for rigid friction.
        yields: softness per torque, and rate at which soft friction stops the joint, 1/s; 0 for hard friction.
        h: integration step, s.
    """
    per_torque = h / resists
    rigid = v + per_torque * net
    # Up to what stops it.
    stops, (soft, rate) = rigid, yields
    if some(rate > 0.0):
        creeps = per_torque * (net + inertia * rate * v) / (1.0 + inertia * soft)
        stops = select(rate > 0.0, creeps, rigid)
    rigid = rigid - clip(stops, 0.0 - per_torque * dry, per_torque * dry)
    elastic = select(dry > 0.0, give, 0.0)
    if not some(elastic > 0.0):
        return rigid, bend
    bends = elastic > 0.0
    per_travel = 1.0 / select(bends, give, 1.0)
    stiff = dry * per_travel
    facing = select(v > 0.0, bend, 0.0 - bend)
    grip = GRIP * root(stiff * inertia) * select(facing < 1.0, 1.0 - facing, 0.0)
    bent = (resists * v + h * (net - dry * bend)) / (resists + h * (h * stiff + grip))
    after = bend + h * per_travel * bent
    slips = magnitude(after) > 1.0
    end = select(after > 0.0, fill(v, 1.0), -1.0)
    slid = v + per_torque * (net - dry * end)
    return select(bends, select(slips, slid, bent), rigid), select(bends, select(slips, end, after), bend)


@compiled
def _residuals(windows, order, inputs, laws, each, lanes, out):
    """Write the residuals of all windows and points to out [P, M]; order: windows by length.

    A lane simulates one window at one point.
    """
    width, jobs = len(lanes), len(order) * len(laws)
    law, terms, more = np.empty(COLUMNS * width), np.empty(ROWS * width), np.empty(ROWS * width)
    driven, start, now = np.empty(each * width), np.empty(4 * width), np.empty(width)
    window, point = np.empty(width, np.int64), np.empty(width, np.int64)
    for first in range(0, jobs, width):
        longest = 0
        for lane in range(width):
            job = min(first + lane, jobs - 1)
            w, p = order[job // len(laws)], job % len(laws)
            window[lane], point[lane] = w, p
            longest = max(longest, windows.edges[w + 1] - windows.edges[w])
            for column in range(COLUMNS):
                law[column * width + lane] = laws[p, column]
            start[lane], start[width + lane] = windows.starts[w, 0], windows.starts[w, 1]
            start[2 * width + lane], start[3 * width + lane] = windows.sides[w], windows.step_s[w] / each
        seen, v, bend, h = load(start, 0, lanes), load(start, 1, lanes), load(start, 2, lanes), load(start, 3, lanes)
        x = seen + 0.5 * bend * load(law, GAP, lanes)
        for k in range(longest):
            store(now, 0, lanes, seen)
            for lane in range(width):
                i = windows.edges[window[lane]] + k
                last = windows.edges[window[lane] + 1] - 1
                if i <= last:
                    there = now[lane] if abs(now[lane]) < FAR else FAR
                    out[point[lane], i] = windows.seen[i] - there
                if i >= last:
                    continue
                path, drive = inputs.path_of[point[lane]], inputs.drive_of[point[lane]]
                for row in range(ROWS):
                    begin = inputs.paths[path, row, i]
                    terms[row * width + lane] = begin
                    more[row * width + lane] = (inputs.paths[path, row, i + 1] - begin) / each
                for j in range(each):
                    driven[j * width + lane] = inputs.drives[drive, i * each + j]
            if k < longest - 1:
                x, seen, v, bend = _sample(x, seen, v, bend, driven, terms, more, law, h, each, lanes)


@inlined
def _sample(x, seen, v, bend, driven, terms, more, law, h, each, lanes):
    """Return position, measured position, speed and bend of the friction one sample later.

    Args:
        x: position.
        seen: measured position, behind the play.
        v: speed.
        bend: bend of the friction.
        driven: drive at each integration step, rows of lanes.
        terms: rigid-body terms at the sample, rows of lanes.
        more: their changes in each integration step.
        law: parameters, rows of lanes.
        h: integration step, s.
        each: integration steps.
        lanes: width of a row.
    """
    kp, kd, low, high = load(law, KP, lanes), load(law, KD, lanes), load(law, LOW, lanes), load(law, HIGH, lanes)
    viscous, drag, dead = load(law, VISCOUS, lanes), load(law, DRAG, lanes), kp * load(law, WIDTH, lanes)
    spring, bias, half = load(law, SPRING, lanes), load(law, BIAS, lanes), 0.5 * load(law, GAP, lanes)
    offset = load(law, OFFSET, lanes) + spring * load(law, REST, lanes)
    stiction, yields = load(law, STICTION, lanes), (load(law, SOFT, lanes), load(law, YIELDS, lanes))
    loaded, from_load = load(law, LOADED, lanes), load(law, FROM_LOAD, lanes)
    ahead, loop_ahead = viscous * load(law, AHEAD, lanes), kd * load(law, LOOP_AHEAD, lanes)
    sticks = some(stiction > 0.0)
    per_speed = 1.0 / select(stiction > 0.0, load(law, SPEED, lanes), 1.0)
    rubs = some(loaded > 0.0)
    per_load_speed = 1.0 / select(loaded > 0.0, load(law, LOAD_SPEED, lanes), 1.0)
    braking = load(law, BACK_EMF, lanes) * viscous
    inertia, weight = load(terms, INERTIA, lanes) + load(law, ARMATURE, lanes), load(terms, LOAD, lanes)
    slope, turning = load(terms, BY_POSITION, lanes), load(terms, BY_SPEED, lanes)
    for j in range(each):
        torque = load(driven, j, lanes) - kp * x
        torque = torque - clip(torque, 0.0 - dead, dead) - kd * v
        limited = clip(torque, low, high)
        rubbing = turning + viscous + drag * magnitude(v)
        clamped = limited != torque
        damping = rubbing + drag * magnitude(v) + select(clamped, 0.0, kd)
        net = limited + offset - weight - (slope + spring) * (x - bias) - rubbing * v
        dry = load(law, DRY, lanes)
        if rubs:
            needed = weight + slope * (x - bias) + turning * v
            ratio = v * per_load_speed
            motor = limited - braking * v
            gear = motor + from_load * (needed - motor)
            dry = dry + loaded * magnitude(gear) * faded(ratio * ratio)
        if sticks:
            ratio = v * per_speed
            dry = dry + stiction * faded(ratio * ratio)
        moved = inertia + ahead + select(clamped, 0.0, loop_ahead)
        resists = resisting(select(moved > 0.1 * inertia, moved, 0.1 * inertia), h * damping)
        v, bend = slide(v, bend, net, resists, inertia, dry, load(law, GIVE, lanes), yields, h)
        x = x + h * v
        seen = clip(seen, x - half, x + half)
        inertia = inertia + load(more, INERTIA, lanes)
        weight = weight + load(more, LOAD, lanes)
        slope = slope + load(more, BY_POSITION, lanes)
        turning = turning + load(more, BY_SPEED, lanes)
    return x, seen, v, bend


@compiled
def free_starts(left, edges, directions, solve):
    """Remove from values left [P, M] what a change of each window's start explains; NaN stays.

    Args:
        left: values, changed in place.
        edges: first samples of the windows, and the end [W + 1].
        directions: change of the values with position and speed at their window's start, [2, M].
        solve: least-squares fit of that change to the values, [2, M].
    """
    for p in range(len(left)):
        for w in range(len(edges) - 1):
            first = second = 0.0
            for i in range(edges[w], edges[w + 1]):
                if not math.isnan(left[p, i]):
                    first += solve[0, i] * left[p, i]
                    second += solve[1, i] * left[p, i]
            for i in range(edges[w], edges[w + 1]):
                left[p, i] -= first * directions[0, i] + second * directions[1, i]


@compiled
def follow(command, rate, lag_s, step_s, out):
    """Write the command [n] that reaches the actuator to out [n]: no faster than `rate`, after a first-order lag.

    The lag's values are means over a step; its end would be half a step early.
    """
    lagging = lag_s > 1e-9
    kept = math.exp(-step_s / lag_s) if lagging else 0.0
    mean = (1.0 - kept) * lag_s / step_s if lagging else 0.0
    limited = filtered = command[0]
    for i in range(len(command)):
        limited += min(max(command[i] - limited, -rate * step_s), rate * step_s)
        out[i] = limited + (filtered - limited) * mean
        filtered = limited + (filtered - limited) * kept
