"""Compiled law of one joint of a mechanism whose other joints follow their measured motion.

The rigid-body terms come from MuJoCo (`rigs/mjcf/mechanism.py`). A step is MuJoCo's semi-implicit Euler step with
implicit damping, so that a fitted value means the same in the model file. Dry friction holds a joint at rest, as real
friction does; MuJoCo's regularised friction lets it creep (its documentation, Computation: Constraint model).
"""

# mypy: allow-untyped-defs, allow-untyped-calls
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from softarm.simulator.compiled import compiler

compiled = compiler(Path(__file__))

# Columns of a law's parameters. Actuator: torque = clip(drive - KP x - KD v, LOW, HIGH), where errors of the position
# below WIDTH make no torque.
KP, KD, LOW, HIGH, WIDTH = range(5)
# Passive: viscous and quadratic friction, spring and its rest position, constant torque, error of the angle's zero.
VISCOUS, DRAG, SPRING, REST, OFFSET, BIAS = range(5, 11)
# Dry friction: sliding, more at rest, the speed at which that has faded, share of the actuator's torque, and the travel
# over which it bends before it slips.
DRY, STICTION, SPEED, LOADED, GIVE = range(11, 16)
# Play between the joint and its sensor; inertia besides the model's.
GAP, ARMATURE = range(16, 18)
COLUMNS = 18
# Damping of friction while it bends, as a share of the root of stiffness times inertia.
GRIP = 0.1
# Rows of a path: inertia, load at zero position and speed, its slopes by position and by speed.
INERTIA, LOAD, BY_POSITION, BY_SPEED = range(4)
ROWS = 4
# Residual of a simulation that diverged.
FAR = 1e3


class Windows(NamedTuple):
    """Measured windows of one trial with T samples in W windows."""

    seen: NDArray[np.float64]  # [T] measured position; NaN where no sample was measured
    edges: NDArray[np.int64]  # [W + 1] first samples of the windows, and the end
    starts: NDArray[np.float64]  # [W, 2] position and speed at the starts
    sides: NDArray[np.float64]  # [W] sign of the last motion before the start


@compiled
def slide(v, bend, net, resists, inertia, dry, give, h):
    """Return speed and bend of the friction after a step of h seconds.

    Args:
        v: speed.
        bend: share of the dry friction that is built up, -1 to 1.
        net: torque without dry friction.
        resists: inertia with the implicit part of the damping.
        inertia: inertia alone.
        dry: level of the dry friction.
        give: travel over which it builds up (elastoplastic, a Prandtl element); 0 for rigid friction.
        h: integration step, s.
    """
    if give <= 0.0 or dry <= 0.0:
        return v + h * (net + min(max(-(v * resists / h + net), -dry), dry)) / resists, bend  # up to what stops it
    stiff = dry / give
    grip = GRIP * math.sqrt(stiff * inertia) * max(1.0 - (bend if v > 0.0 else -bend), 0.0)
    bent = (resists * v + h * (net - dry * bend)) / (resists + h * (h * stiff + grip))
    after = bend + h * bent / give
    if abs(after) <= 1.0:
        return bent, after
    after = 1.0 if after > 0.0 else -1.0
    return v + h * (net - dry * after) / resists, after


@compiled
def travel(start, side, drive, path, law, step_s, each, out):
    """Simulate a joint from a start; write the measured value at each sample to out [T], and return its play's side.

    Args:
        start: position and speed, [2].
        side: place within the play, and bend of the friction, -1 to 1.
        drive: drive of the actuator at each integration step, [T each].
        path: rigid-body terms at each sample, [ROWS, T].
        law: parameters by the columns above.
        step_s: sampling interval.
        each: integration steps per sample.
    """
    h, size, half = step_s / each, len(out), 0.5 * law[GAP]
    kp, kd, low, high, width = law[KP], law[KD], law[LOW], law[HIGH], law[KP] * law[WIDTH]
    viscous, drag, spring, offset = law[VISCOUS], law[DRAG], law[SPRING], law[OFFSET] + law[SPRING] * law[REST]
    seen, v = start[0], start[1]
    x, bend = seen + side * half, side
    for i in range(size):
        out[i] = seen
        last = min(i + 1, path.shape[1] - 1)
        inertia, load = path[INERTIA, i] + law[ARMATURE], path[LOAD, i]
        slope, turning = path[BY_POSITION, i], path[BY_SPEED, i]
        inertia_more, load_more = (path[INERTIA, last] - path[INERTIA, i]) / each, (path[LOAD, last] - load) / each
        slope_more, turning_more = (path[BY_POSITION, last] - slope) / each, (path[BY_SPEED, last] - turning) / each
        for j in range(each):
            true = x - law[BIAS]
            torque = drive[i * each + j] - kp * x
            torque -= min(max(torque, -width), width)
            torque -= kd * v
            damping = viscous + 2.0 * drag * abs(v) + turning + kd
            if torque < low or torque > high:
                torque = min(max(torque, low), high)
                damping -= kd
            net = torque + offset - load - (slope + spring) * true - (turning + viscous + drag * abs(v)) * v
            dry = law[DRY] + law[LOADED] * abs(torque)
            if law[STICTION] > 0.0:
                dry += law[STICTION] * math.exp(-((v / law[SPEED]) ** 2))
            resists = max(inertia + h * damping, 0.1 * inertia)
            v, bend = slide(v, bend, net, resists, inertia, dry, law[GIVE], h)
            x += h * v
            seen = min(max(seen, x - half), x + half)
            inertia += inertia_more
            load += load_more
            slope += slope_more
            turning += turning_more
    return (x - seen) / half if half > 0.0 else 0.0


@compiled
def residuals(windows, drive, path, law, step_s, each, out):
    """Simulate every window from its guessed start and write measured minus predicted values to out [T].

    Other arguments are those of `travel`, for all windows.
    """
    for w in range(len(windows.edges) - 1):
        a, b = windows.edges[w], windows.edges[w + 1]
        driven, terms = drive[a * each : b * each], path[:, a : min(b + 1, path.shape[1])]
        travel(windows.starts[w], windows.sides[w], driven, terms, law, step_s, each, out[a:b])
        for i in range(a, b):
            out[i] = windows.seen[i] - (out[i] if abs(out[i]) < FAR else FAR)


@compiled
def free_starts(left, edges, directions, solve):
    """Remove from values left [T] what a change of each window's start explains; NaN stays.

    Args:
        left: values, changed in place.
        edges: first samples of the windows, and the end [W + 1].
        directions: change of the values with position and speed at their window's start, [2, T].
        solve: least-squares fit of that change to the values, [2, T].
    """
    for w in range(len(edges) - 1):
        first = second = 0.0
        for i in range(edges[w], edges[w + 1]):
            if not math.isnan(left[i]):
                first += solve[0, i] * left[i]
                second += solve[1, i] * left[i]
        for i in range(edges[w], edges[w + 1]):
            left[i] -= first * directions[0, i] + second * directions[1, i]


@compiled
def follow(command, rate, lag_s, step_s, out):
    """Write the command [n] that reaches the actuator to out [n]: no faster than `rate`, after a first-order lag."""
    kept = math.exp(-step_s / lag_s) if lag_s > 1e-9 else 0.0
    limited = filtered = command[0]
    for i in range(len(command)):
        limited += min(max(command[i] - limited, -rate * step_s), rate * step_s)
        filtered = limited + (filtered - limited) * kept
        out[i] = filtered
