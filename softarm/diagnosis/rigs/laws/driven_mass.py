"""Compiled law of a mass that a force moves against friction, with the amplifier that makes the force.

While the mass slides under a constant force every step is exact, including a stop within it: Karnopp 1985 without his
band of small velocities. After a reversal friction bends before it slips (Dahl 1968), in short steps of its own.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from softarm.simulator.compiled import compiler

compiled = compiler(Path(__file__))

# Columns of a law's parameters, first those of the input.
GAIN, WIDTH, LIMIT, LAG = range(4)
# Mass: sliding friction in either direction, additional friction at rest, the speed at which that has faded, and the
# travel over which friction bends before it slips (its force reaches 1 - 1/e of its full value).
MASS, FORWARD, BACKWARD, STICTION, SPEED, GIVE, VISCOUS, DRAG, OFFSET = range(4, 13)
# Sensor: play, a spring (angular frequency, 0 for none; damping ratio; and its share at the sensor: -1 for a light load
# on the mass, or load over motor if the sensor sits on the motor), bias.
GAP, OMEGA, RATIO, SHARE, BIAS = range(13, 18)
COLUMNS = 18
# A start has converged if its next change moves the prediction by less than this share of the noise floor.
CLOSE = 0.02
# Steps of bending friction per inverse of its frequency, and most sub-steps of a step.
FINE, MOST = 4.0, 64
# Damping ratio of a mass on its bent friction.
GRIP = 0.3
# Share of the give at which friction slips.
SLIPS = 0.99
# Shares of the friction, and of the speed that it would stop within its give, below which the mass has stopped.
SETTLED = 0.01
# Step of the numerical derivative by a start's velocity, in its uncertainty.
NUDGE = 0.05


class Windows(NamedTuple):
    """Measured windows of one trial with T samples in W windows."""

    seen: NDArray[np.float64]  # [T] measured position or speed; NaN where no sample was measured
    edges: NDArray[np.int64]  # [W + 1] first samples of the windows, and the end
    starts: NDArray[np.float64]  # [W, 2] measured position and speed at the starts
    spread: NDArray[np.float64]  # [2] uncertainty of these
    sides: NDArray[np.float64]  # [W] sign of the last motion before the start
    moving: NDArray[np.float64]  # [W] sign of the motion at the start, 0 at rest


class Fit(NamedTuple):
    """Settings of the fit of a window's start."""

    floor: float  # noise floor of the measured values
    step_s: float  # sampling interval
    each: int  # integration steps per sample
    rounds: int  # Gauss-Newton iterations
    speed: bool  # the speed is measured instead of the position


@compiled
def drive(held, law, step_s, out):
    """Write the force [n] that an input [n] makes, both means over steps: dead zone, limit, lag, gain."""
    kept = math.exp(-step_s / law[LAG]) if law[LAG] > 1e-9 else 0.0
    filtered = 0.0
    for i in range(len(held)):
        u = held[i]
        u -= min(max(u, -law[WIDTH]), law[WIDTH])
        u = min(max(u, -law[LIMIT]), law[LIMIT])
        if i == 0:
            filtered = u
        before = filtered
        filtered = u + (before - u) * kept
        mean = u if kept == 0.0 else u + (before - filtered) * law[LAG] / step_s
        out[i] = law[GAIN] * mean


@compiled
def move(x, v, z, force, law, step_s):
    """Return position, speed and friction's bend after a step under a constant force.

    Within the step the mass may stop, stay, break away and reverse. The bend z is within [-give, give].
    """
    left, push = step_s, force + law[OFFSET]
    dry = law[STICTION] > 0.0 or law[FORWARD] > 0.0 or law[BACKWARD] > 0.0
    give = law[GIVE] if dry and _yields(law, step_s) else 0.0
    if give == 0.0:
        z = 0.0
    for _ in range(MOST):
        extra = law[STICTION] * math.exp(-((v / law[SPEED]) ** 2)) if law[STICTION] > 0.0 else 0.0
        forward, backward = law[FORWARD] + extra, law[BACKWARD] + extra
        direction = (v > 0.0) - (v < 0.0)
        if direction == 0:
            direction = (push > forward) - (push < -backward)
        if direction != 0 and (give == 0.0 or z * direction >= give):
            x, v, used = _slide(x, v, push - forward if direction > 0 else push + backward, law, left)
            left -= used
        elif give == 0.0:
            break  # friction holds it
        else:
            x, v, z, left = _bend(x, v, z, push, give, law, left)
        if left <= 1e-9 * step_s:
            break
    return x, v, z


@compiled
def _yields(law, step_s):
    """Whether a step is short enough to follow the give; the bend of a stiffer friction does not show."""
    level = max(law[FORWARD], law[BACKWARD]) + law[STICTION]
    return law[GIVE] > 0.0 and level * (FINE * step_s / MOST) ** 2 < law[GIVE] * law[MASS]


@compiled
def _slide(x, v, net, law, left):
    """Slide under a net force until the stop or the time is up; return position, speed, time used."""
    damping = law[VISCOUS]
    if law[DRAG] > 0.0:
        gained = (net - (damping + law[DRAG] * abs(v)) * v) / law[MASS]
        damping += law[DRAG] * abs(v + 0.5 * left * gained)
    time = left
    if law[STICTION] > 0.0 and abs(v) < 4.0 * law[SPEED] and net != 0.0:  # the Stribeck curve needs short steps
        time = min(time, 0.2 * law[SPEED] * law[MASS] / abs(net))
    stops = False
    if v * net < 0.0:
        share = damping * abs(v / net)
        stop = law[MASS] * abs(v / net) * (math.log1p(share) / share if share > 1e-6 else 1.0 - 0.5 * share)
        stops = stop <= time
        time = min(stop, time)
    k = damping * time / law[MASS]
    if k < 1e-3:
        first, second = 1.0 - k * (0.5 - k / 6.0), 0.5 - k * (1.0 / 6.0 - k / 24.0)
    else:
        first = (1.0 - math.exp(-k)) / k
        second = (1.0 - first) / k
    gained = (net - damping * v) / law[MASS]
    x += v * time + gained * time * time * second
    v = 0.0 if stops else v + gained * time * first
    return x, v, time


@compiled
def _bend(x, v, z, push, give, law, left):
    """Move while friction bends like a spring up to `give`, until it slips or the time is up."""
    level = max(law[FORWARD], law[BACKWARD]) + law[STICTION]
    omega = math.sqrt(level / (give * law[MASS]))
    count = math.ceil(left * FINE * omega)
    step = left / count
    grip = 2.0 * GRIP * law[MASS] * omega
    for i in range(count):
        extra = law[STICTION] * math.exp(-((v / law[SPEED]) ** 2)) if law[STICTION] > 0.0 else 0.0
        hold = (law[FORWARD] + extra if z > 0.0 else law[BACKWARD] + extra) * z / give
        if abs(push - hold) < SETTLED * level and abs(v) < SETTLED * give * omega:
            v = 0.0
            break  # the remaining motion is negligible
        bending = grip * max(1.0 - (z if v > 0.0 else -z) / give, 0.0)
        v += step * (push - hold - (law[VISCOUS] + bending + law[DRAG] * abs(v)) * v) / law[MASS]
        x += step * v
        rest = give if v > 0.0 else -give
        z = rest + (z - rest) * math.exp(-abs(step * v) / give)
        if z * rest > SLIPS * give * give:
            return x, v, rest, left - (i + 1) * step
    return x, v, z, 0.0


@compiled
def travel(start, state, force, law, step_s, each, speed, out):
    """Simulate a mass from a start under forces [T each]; write the measured value at each sample to out [T].

    Args:
        start: measured position and speed, [2].
        state: replaced by its value at the end, [4]: place within the play (-1 to 1), bend of the spring and its rate,
            and the friction's bend over its give.
        force: force at each integration step, [T each].
        law: parameters by the columns above.
        step_s: sampling interval.
        each: integration steps per sample.
        speed: whether the speed is measured instead of the position; it contains no play.
        out: result, [T].
    """
    h = step_s / each
    half, omega, ratio = 0.5 * law[GAP], law[OMEGA], law[RATIO]
    turn, grip = math.sqrt(1.0 - ratio * ratio) * omega, ratio * omega
    fade = math.exp(-grip * h)
    c, s = math.cos(turn * h), math.sin(turn * h) / turn if omega > 0.0 else h
    bent, bending = (state[1], state[2]) if omega > 0.0 else (0.0, 0.0)
    seen, v, z = start[0], start[1] - bending, law[GIVE] * state[3]
    x = seen + state[0] * half - bent
    for i in range(len(out)):
        out[i] = (v + bending if speed else seen) + law[BIAS]
        for j in range(each):
            before = v
            x, v, z = move(x, v, z, force[i * each + j], law, h)
            if omega > 0.0:
                rest = law[SHARE] * (v - before) / h / (omega * omega)
                off = bent - rest
                bent = rest + fade * (off * (c + grip * s) + bending * s)
                bending = fade * (bending * (c - grip * s) - off * omega * omega * s)
            seen = min(max(seen, x + bent - half), x + bent + half)
    if half > 0.0:
        state[0] = (x + bent - seen) / half
    state[1], state[2] = bent, bending
    if law[GIVE] > 0.0:
        state[3] = z / law[GIVE]


@compiled
def _first(side, moving, force, law, state):
    """Set the state at the start of the first window: at rest under its first force, or moving."""
    push = force + law[OFFSET]
    level = law[FORWARD] if push > 0.0 else law[BACKWARD]
    held = min(max(push / level, -1.0), 1.0) if level > 0.0 else 0.0
    state[0], state[2], state[3] = side, 0.0, moving if moving != 0.0 else held
    slides = push - moving * level if moving != 0.0 else push - held * level
    state[1] = law[SHARE] * slides / law[MASS] / law[OMEGA] ** 2 if law[OMEGA] > 0.0 else 0.0


@compiled
def residuals(windows, force, law, fit, out):
    """Fit the start of each window and write measured minus predicted values to out [T].

    Play, spring and friction carry their state from window to window. force: [T each].
    """
    state = np.zeros(4)
    for w in range(len(windows.edges) - 1):
        a, b = windows.edges[w], windows.edges[w + 1]
        if w == 0:
            _first(windows.sides[w], windows.moving[w], force[0], law, state)
        elif windows.moving[w] != 0.0:
            state[3] = windows.moving[w]
        driven = force[a * fit.each : b * fit.each]
        _fit_window(windows.seen[a:b], windows.starts[w], windows.spread, state, driven, law, fit, out[a:b])


@compiled
def _fit_window(seen, guess, spread, state, force, law, fit, out):
    """Fit the start of one window by Gauss-Newton from a guess; write its residuals and final state."""
    size = len(seen)
    start, best = guess.copy(), guess.copy()
    base, column = np.empty(size), np.empty(size)
    begun, end, ended = state.copy(), state.copy(), state.copy()
    least, ones = np.inf, 0.0 if fit.speed else 1.0  # a speed does not depend on the position
    w0, w1 = (fit.floor / spread[0]) ** 2, (fit.floor / spread[1]) ** 2
    for k in range(fit.rounds + 1):
        end[:] = begun
        travel(start, end, force, law, fit.step_s, fit.each, fit.speed, base)
        loss = w0 * (start[0] - guess[0]) ** 2 + w1 * (start[1] - guess[1]) ** 2
        for i in range(size):
            if not math.isnan(seen[i]):
                loss += (seen[i] - base[i]) ** 2
        if loss >= least:  # too far: go back by half
            start[0], start[1] = 0.5 * (start[0] + best[0]), 0.5 * (start[1] + best[1])
            continue
        least, best[0], best[1] = loss, start[0], start[1]
        ended[:] = end
        for i in range(size):
            out[i] = seen[i] - base[i]
        if k == fit.rounds:
            break
        nudge = NUDGE * spread[1]
        start[1] += nudge
        end[:] = begun
        travel(start, end, force, law, fit.step_s, fit.each, fit.speed, column)
        start[1] -= nudge
        n00, n01, n11 = w0, 0.0, w1
        s0, s1 = -w0 * (start[0] - guess[0]), -w1 * (start[1] - guess[1])
        for i in range(size):
            if not math.isnan(seen[i]):
                column[i] = (column[i] - base[i]) / nudge
                n00 += ones
                n01 += ones * column[i]
                n11 += column[i] * column[i]
                s0 += ones * out[i]
                s1 += column[i] * out[i]
        determinant = n00 * n11 - n01 * n01
        change = (n11 * s0 - n01 * s1) / determinant, (n00 * s1 - n01 * s0) / determinant
        if abs(change[0]) < CLOSE * fit.floor and abs(change[1]) < CLOSE * fit.floor / (size * fit.step_s):
            break
        start[0] += change[0]
        start[1] += change[1]
    state[:] = ended
