"""A mass that a force moves against friction, compiled: what an amplifier makes of its input, and how the mass goes.

While it slides under a constant force every step is exact, the stop within it too: Karnopp 1985 without his band of
small velocities. After a reversal friction bends before it slips (Dahl 1968), in short steps of its own.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
import math
from pathlib import Path

import numpy as np

from softarm.simulator.compiled import compiler

compiled = compiler(Path(__file__))

# Columns of a law's parameters. Of the input:
GAIN, WIDTH, LIMIT, LAG = range(4)
# Of the mass: friction either way while it slides, what sticking holds beyond that, up to which speed that fades, and
# the way on which friction bends before it slips (its force closes on its full value by 1 - 1/e on each).
MASS, FORWARD, BACKWARD, STICTION, SPEED, GIVE, VISCOUS, DRAG, OFFSET = range(4, 13)
# Of what is seen: play, a spring (its angular frequency, 0 for none, damping ratio, and what it adds at the sensor: -1
# for a light end that hangs on the mass, the load over the rest where the sensor sits on what is driven), bias.
GAP, OMEGA, RATIO, SHARE, BIAS = range(13, 18)
COLUMNS = 18
CLOSE = 0.02  # of the floor: a start that would change what is seen by less is found
FINE, MOST = 4.0, 64  # steps of a bent friction in 1 / its frequency; stretches of a step at the most
GRIP = 0.3  # damping ratio of a mass on its bent friction
SLIPS = 0.99  # of the give
SETTLED = 0.01  # of the friction, and of the speed that it would stop within its give
NUDGE = 0.05  # of a start's velocity, in its spread


@compiled
def drive(held, law, step_s, out):
    """Force [n] of an input [n], both means over steps: dead zone, end of the force, lag, gain."""
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
    """Where a mass is, how fast, and how far its friction is bent, after a step under a constant force.

    Within the step it may stop, stay, break away and go the other way. z: [-give, give]; friction grows with it.
    """
    left, push = step_s, force + law[OFFSET]
    dry = law[STICTION] > 0.0 or law[FORWARD] > 0.0 or law[BACKWARD] > 0.0
    give = law[GIVE] if dry and _yields(law, step_s) else 0.0
    if give == 0.0:
        z = 0.0
    for _ in range(MOST):
        extra = law[STICTION] * math.exp(-((v / law[SPEED]) ** 2)) if law[STICTION] > 0.0 else 0.0
        forward, backward = law[FORWARD] + extra, law[BACKWARD] + extra
        way = (v > 0.0) - (v < 0.0)
        if way == 0:
            way = (push > forward) - (push < -backward)
        if way != 0 and (give == 0.0 or z * way >= give):
            x, v, used = _slide(x, v, push - forward if way > 0 else push + backward, law, left)
            left -= used
        elif give == 0.0:
            break  # it stays
        else:
            x, v, z, left = _bend(x, v, z, push, give, law, left)
        if left <= 1e-9 * step_s:
            break
    return x, v, z


@compiled
def _yields(law, step_s):
    """Whether the give can be followed by so short a step; a stiffer friction has none that would show."""
    level = max(law[FORWARD], law[BACKWARD]) + law[STICTION]
    return law[GIVE] > 0.0 and level * (FINE * step_s / MOST) ** 2 < law[GIVE] * law[MASS]


@compiled
def _slide(x, v, net, law, left):
    """Slide under a net force as long as it lasts, to the stop at the most: position, speed, time."""
    damping = law[VISCOUS]
    if law[DRAG] > 0.0:
        gained = (net - (damping + law[DRAG] * abs(v)) * v) / law[MASS]
        damping += law[DRAG] * abs(v + 0.5 * left * gained)
    time = left
    if law[STICTION] > 0.0 and abs(v) < 4.0 * law[SPEED] and net != 0.0:  # the Stribeck curve asks for short steps
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
    """Move while friction bends like a spring, until it slips or the time is up: `give` is how far it bends."""
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
            break  # it stays, but for what nobody would see
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
    """Let a mass go from a start under forces [T each]; out: [T], what is seen at the start of each step.

    start: position and speed of what is seen; state: [4], changed into that at the end: where in its play the mass is
    (-1 to 1), how far the spring is bent and how fast, share of the friction's give. speed: whether the speed is seen
    instead of the position; play is not in it then.
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
    """A window's state where none comes before it: as it stays under its first force."""
    push = force + law[OFFSET]
    level = law[FORWARD] if push > 0.0 else law[BACKWARD]
    held = min(max(push / level, -1.0), 1.0) if level > 0.0 else 0.0
    state[0], state[2], state[3] = side, 0.0, moving if moving != 0.0 else held
    slides = push - moving * level if moving != 0.0 else push - held * level
    state[1] = law[SHARE] * slides / law[MASS] / law[OMEGA] ** 2 if law[OMEGA] > 0.0 else 0.0


@compiled
def shots(seen, edges, starts, spread, sides, moving, force, law, floor, step_s, each, rounds, speed, out):
    """Fit where each window starts (Gauss-Newton, `rounds`) and write what is left, measured minus seen, [T].

    seen: [T], NaN where nothing was measured; edges: [W + 1] of the windows; starts: [W, 2] position and speed as they
    were measured there, spread: [2] how well; sides, moving: [W] which way the mass went last, and goes there (0: at
    rest); force: [T each]. Play, spring and friction go on from window to window.
    """
    state = np.zeros(4)
    for w in range(len(edges) - 1):
        a, b = edges[w], edges[w + 1]
        if w == 0:
            _first(sides[w], moving[w], force[0], law, state)
        elif moving[w] != 0.0:
            state[3] = moving[w]
        mine = force[a * each : b * each]
        _shot(seen[a:b], starts[w], spread, state, mine, law, floor, step_s, each, rounds, speed, out[a:b])


@compiled
def _shot(seen, guess, spread, state, force, law, floor, step_s, each, rounds, speed, out):
    size = len(seen)
    start, best = guess.copy(), guess.copy()
    base, column = np.empty(size), np.empty(size)
    begun, end, ended = state.copy(), state.copy(), state.copy()
    least, ones = np.inf, 0.0 if speed else 1.0  # of a velocity the position tells nothing
    w0, w1 = (floor / spread[0]) ** 2, (floor / spread[1]) ** 2
    for k in range(rounds + 1):
        end[:] = begun
        travel(start, end, force, law, step_s, each, speed, base)
        loss = w0 * (start[0] - guess[0]) ** 2 + w1 * (start[1] - guess[1]) ** 2
        for i in range(size):
            if not math.isnan(seen[i]):
                loss += (seen[i] - base[i]) ** 2
        if loss >= least:  # too far: half of the way back
            start[0], start[1] = 0.5 * (start[0] + best[0]), 0.5 * (start[1] + best[1])
            continue
        least, best[0], best[1] = loss, start[0], start[1]
        ended[:] = end
        for i in range(size):
            out[i] = seen[i] - base[i]
        if k == rounds:
            break
        nudge = NUDGE * spread[1]
        start[1] += nudge
        end[:] = begun
        travel(start, end, force, law, step_s, each, speed, column)
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
        further = (n11 * s0 - n01 * s1) / determinant, (n00 * s1 - n01 * s0) / determinant
        if abs(further[0]) < CLOSE * floor and abs(further[1]) < CLOSE * floor / (size * step_s):
            break
        start[0] += further[0]
        start[1] += further[1]
    state[:] = ended
