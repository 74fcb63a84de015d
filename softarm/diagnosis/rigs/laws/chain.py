"""Compiled law of a chain of n links that turn in one plane: many starts and parameters at once, one in each lane.

Angles are absolute, zero hanging down. The base is fixed or moves sideways; every joint may have a motor.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
from pathlib import Path

import numpy as np

from softarm.simulator.compiled import compiler
from softarm.simulator.kernel.compiled import SOURCES
from softarm.simulator.kernel.numerics import clip, sine_cosine
from softarm.simulator.simd import fill, load, root, some, store

compiled = compiler(Path(__file__), *SOURCES)

# Number of simulations computed together; enough to hide the latency of a division.
LANES = 32
_LANES = (0,) * LANES

# Rows of a law, each for links or joints 1 .. n. MOMENT: mass times arm; INERTIA: on the diagonal; GIVE: turn until the
# dry friction is whole; ARMATURE: inertia of the motor; GAIN, OFFSET: of the motor's torque.
MOMENT, INERTIA, LENGTH, CENTRE, VISCOUS, DRY, GIVE, ARMATURE, GAIN, OFFSET = range(10)
EACH = 10
# After these, one number each: gravity down and along the base, growth of the weight with the angle squared, drag.
DOWN, ALONG, CUBIC, DRAG = range(4)
ALL = 4

# Rows of the state: angle, rate, shear of the dry friction. Then the work space of a step.
_Q, _V, _Z, _QS, _VS, _ZS, _SUM_Q, _SUM_V, _RHS, _SINE, _COSINE = range(11)


@compiled
def accelerations(law, w, n, torque, push):
    """Write the angular accelerations for the state of a Runge-Kutta stage.

    Args:
        law: rows of the law, in lanes.
        w: state and work space, in lanes.
        n: number of links.
        torque: motor torques, N m, [n].
        push: acceleration of the base, m/s^2.
    """
    down, along = load(law, EACH * n + DOWN, _LANES), load(law, EACH * n + ALONG, _LANES)
    cubic, matrix = load(law, EACH * n + CUBIC, _LANES), (_COSINE + 1) * n
    for i in range(n):
        q = load(w, _QS * n + i, _LANES)
        s, c = sine_cosine(q)
        store(w, _SINE * n + i, _LANES, s)
        store(w, _COSINE * n + i, _LANES, c)
        lean = (down * s + along * c) * (1.0 + cubic * q * q) + c * push
        moment, own = load(law, MOMENT * n + i, _LANES), load(law, ARMATURE * n + i, _LANES)
        forced = 0.0 - moment * lean
        v = load(w, _VS * n + i, _LANES)
        for j in range(i):
            arm = load(law, LENGTH * n + j, _LANES) * moment
            sj, cj, vj = (
                load(w, _SINE * n + j, _LANES),
                load(w, _COSINE * n + j, _LANES),
                load(w, _VS * n + j, _LANES),
            )
            across = arm * (s * cj - c * sj)
            forced = forced - across * vj * vj
            store(w, _RHS * n + j, _LANES, load(w, _RHS * n + j, _LANES) + across * v * v)
            coupled = arm * (c * cj + s * sj)
            if j == i - 1:
                coupled = coupled - own
                place = matrix + j * n + j
                store(w, place, _LANES, load(w, place, _LANES) + own)
            store(w, matrix + i * n + j, _LANES, coupled)
        before = load(w, _VS * n + i - 1, _LANES) if i > 0 else fill(v, 0.0)
        stiffness = load(law, DRY * n + i, _LANES) / load(law, GIVE * n + i, _LANES)
        held = load(law, VISCOUS * n + i, _LANES) * (v - before) + stiffness * load(w, _ZS * n + i, _LANES)
        driven = torque[i] * load(law, GAIN * n + i, _LANES) + load(law, OFFSET * n + i, _LANES)
        net = driven - held
        if i > 0:
            store(w, _RHS * n + i - 1, _LANES, load(w, _RHS * n + i - 1, _LANES) - net)
        store(w, _RHS * n + i, _LANES, forced + net)
        store(w, matrix + i * n + i, _LANES, load(law, INERTIA * n + i, _LANES) + own)
    drag = load(law, EACH * n + DRAG, _LANES)
    if some(drag > 0.0):
        _add_drag(law, w, n, drag)
    _solve(w, n, matrix)


@compiled
def _add_drag(law, w, n, coefficient):
    """Add the quadratic drag of every link at its centre."""
    for i in range(n):
        y = fill(coefficient, 0.0)
        z = fill(coefficient, 0.0)
        for j in range(i + 1):
            speed = load(law, (CENTRE if j == i else LENGTH) * n + j, _LANES) * load(w, _VS * n + j, _LANES)
            y = y + speed * load(w, _COSINE * n + j, _LANES)
            z = z + speed * load(w, _SINE * n + j, _LANES)
        force = coefficient * root(y * y + z * z)
        for j in range(i + 1):
            arm = force * load(law, (CENTRE if j == i else LENGTH) * n + j, _LANES)
            along = y * load(w, _COSINE * n + j, _LANES) + z * load(w, _SINE * n + j, _LANES)
            store(w, _RHS * n + j, _LANES, load(w, _RHS * n + j, _LANES) - arm * along)


@compiled
def _solve(w, n, matrix):
    """Solve by Gauss without pivots: the matrix is symmetric and positive definite, only its lower half is used."""
    for i in range(n - 1, 0, -1):
        own = load(w, matrix + i * n + i, _LANES)
        mine = load(w, _RHS * n + i, _LANES)
        for k in range(i):
            f = load(w, matrix + i * n + k, _LANES) / own
            store(w, _RHS * n + k, _LANES, load(w, _RHS * n + k, _LANES) - f * mine)
            for j in range(k + 1):
                place = matrix + k * n + j
                store(w, place, _LANES, load(w, place, _LANES) - f * load(w, matrix + i * n + j, _LANES))
    for i in range(n):
        value = load(w, _RHS * n + i, _LANES)
        for j in range(i):
            value = value - load(w, matrix + i * n + j, _LANES) * load(w, _RHS * n + j, _LANES)
        store(w, _RHS * n + i, _LANES, value / load(w, matrix + i * n + i, _LANES))


@compiled
def _shear(law, w, n, now, out):
    """Shear each joint's friction by its turn since the step began, until it slips."""
    turned = fill(load(w, _Q * n, _LANES), 0.0)
    for i in range(n):
        turn = load(w, now * n + i, _LANES) - load(w, _Q * n + i, _LANES)
        give = load(law, GIVE * n + i, _LANES)
        store(w, out * n + i, _LANES, clip(load(w, _Z * n + i, _LANES) + turn - turned, 0.0 - give, give))
        turned = turn


@compiled
def _step(law, w, n, torque, push, h):
    """Advance by one Runge-Kutta step of fourth order; friction is sheared with the joints."""
    for i in range(n):
        store(w, _QS * n + i, _LANES, load(w, _Q * n + i, _LANES))
        store(w, _VS * n + i, _LANES, load(w, _V * n + i, _LANES))
        store(w, _SUM_Q * n + i, _LANES, 0.0)
        store(w, _SUM_V * n + i, _LANES, 0.0)
    for stage in range(4):
        if stage > 0:
            back = h if stage == 3 else 0.5 * h
            for i in range(n):
                slope = load(w, _VS * n + i, _LANES)
                store(w, _QS * n + i, _LANES, load(w, _Q * n + i, _LANES) + back * slope)
                store(w, _VS * n + i, _LANES, load(w, _V * n + i, _LANES) + back * load(w, _RHS * n + i, _LANES))
        _shear(law, w, n, _QS, _ZS)
        accelerations(law, w, n, torque, push)
        share = h / 6.0 if stage in (0, 3) else h / 3.0
        for i in range(n):
            sums, rates = load(w, _SUM_Q * n + i, _LANES), load(w, _SUM_V * n + i, _LANES)
            store(w, _SUM_Q * n + i, _LANES, sums + share * load(w, _VS * n + i, _LANES))
            store(w, _SUM_V * n + i, _LANES, rates + share * load(w, _RHS * n + i, _LANES))
    for i in range(n):
        store(w, _QS * n + i, _LANES, load(w, _Q * n + i, _LANES) + load(w, _SUM_Q * n + i, _LANES))
        store(w, _V * n + i, _LANES, load(w, _V * n + i, _LANES) + load(w, _SUM_V * n + i, _LANES))
    _shear(law, w, n, _QS, _ZS)
    for i in range(n):
        store(w, _Q * n + i, _LANES, load(w, _QS * n + i, _LANES))
        store(w, _Z * n + i, _LANES, load(w, _ZS * n + i, _LANES))


@compiled
def swing(law, start, torque, push, h, each, out):
    """Simulate W windows from L starts, each with its own law; the first sample is the start.

    Args:
        law: L laws in B blocks of lanes, [B, (10 n + 4) 32].
        start: angles, rates and shears, [W, B, 3 n 32].
        torque: motor torques at every step, N m, [W, T each, n].
        push: acceleration of the base at every step, m/s^2, [W, T each].
        h: length of a step, s.
        each: steps per sample.
        out: angles, rad, [W, B, T n 32].
    """
    n = torque.shape[2]
    w = np.zeros(((_COSINE + 1) * n + n * n) * LANES)
    for k in range(out.shape[0]):
        for b in range(out.shape[1]):
            w[: 3 * n * LANES] = start[k, b]
            for t in range(torque.shape[1] // each):
                for i in range(n):
                    store(out[k, b], t * n + i, _LANES, load(w, _Q * n + i, _LANES))
                for s in range(t * each, (t + 1) * each):
                    _step(law[b], w, n, torque[k, s], push[k, s], h)
