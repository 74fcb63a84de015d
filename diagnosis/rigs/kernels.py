"""The law of a chain of pendulums, compiled."""

# mypy: allow-untyped-defs, allow-untyped-calls
import math
from pathlib import Path

import numpy as np

from softarm.simulator.compiled import compiler

compiled = compiler(Path(__file__))

# Columns of a pendulum's parameters; all links alike.
GRAVITY, CUBIC, DAMPING, TORQUE, GIVE, DRAG = range(6)


@compiled
def accelerations(q, v, z, push, link, law, matrix, rhs):
    """Angular accelerations of a chain of n links into rhs.

    q, v: [n] absolute angles and rates; z: [n] how far each joint's friction is sheared; push: m/s^2 of the base;
    link: [5, n] static moment (mass times arm), inertia on the diagonal, length, centre, damping; law: see above.
    """
    n = len(q)
    if n == 1:  # the usual case, and six times as fast
        held = min(max(z[0] / law[GIVE], -1.0), 1.0)
        speed = law[DRAG] * link[3, 0] ** 3 * abs(v[0]) + law[DAMPING] * link[4, 0]
        lean = law[GRAVITY] * math.sin(q[0]) * (1.0 + law[CUBIC] * q[0] * q[0]) + math.cos(q[0]) * push
        rhs[0] = -(link[0, 0] * lean + speed * v[0] + law[TORQUE] * held) / link[1, 0]
        return
    for i in range(n):
        rhs[i] = -link[0, i] * (
            law[GRAVITY] * math.sin(q[i]) * (1.0 + law[CUBIC] * q[i] * q[i]) + math.cos(q[i]) * push
        )
        matrix[i, i] = link[1, i]
        for j in range(i):
            arm = link[2, j] * link[0, i]
            c, s = math.cos(q[i] - q[j]), math.sin(q[i] - q[j])
            matrix[i, j] = matrix[j, i] = arm * c
            rhs[i] -= arm * s * v[j] * v[j]
            rhs[j] += arm * s * v[i] * v[i]
    for i in range(n):
        rate = v[i] - (v[i - 1] if i > 0 else 0.0)
        held = min(max(z[i] / law[GIVE], -1.0), 1.0)
        torque = law[DAMPING] * link[4, i] * rate + law[TORQUE] * held
        rhs[i] -= torque
        if i > 0:
            rhs[i - 1] += torque
    if law[DRAG] > 0.0:
        _add_drag(q, v, link, law[DRAG], rhs)
    _solve(matrix, rhs)


@compiled
def _add_drag(q, v, link, coefficient, rhs):
    """Quadratic drag of every link at its centre."""
    for i in range(len(q)):
        y = z = 0.0
        for j in range(i + 1):
            arm = link[3, i] if j == i else link[2, j]
            y += arm * math.cos(q[j]) * v[j]
            z += arm * math.sin(q[j]) * v[j]
        force = -coefficient * math.sqrt(y * y + z * z)
        for j in range(i + 1):
            arm = link[3, i] if j == i else link[2, j]
            rhs[j] += force * arm * (y * math.cos(q[j]) + z * math.sin(q[j]))


@compiled
def _solve(matrix, rhs):
    """Gauss without pivots: the matrix is positive definite."""
    n = len(rhs)
    for i in range(n):
        for k in range(i + 1, n):
            f = matrix[k, i] / matrix[i, i]
            for j in range(i + 1, n):
                matrix[k, j] -= f * matrix[i, j]
            rhs[k] -= f * rhs[i]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            rhs[i] -= matrix[i, j] * rhs[j]
        rhs[i] /= matrix[i, i]


@compiled
def swing(state, shear, push, link, law, step_s, each, out):
    """Let a chain swing (Runge and Kutta, fourth order); out: [T, n] angles, the first at the start.

    state: [2 n] angles, rates; shear: [n] of the frictions at the start; push: [T] of the base, m/s^2.
    """
    n = len(shear)
    q, v, z = state[:n].copy(), state[n:].copy(), shear.copy()
    h = step_s / each
    matrix = np.empty((n, n))
    kq, kv = np.empty((4, n)), np.empty((4, n))
    qs, vs, zs = np.empty(n), np.empty(n), np.empty(n)
    for t in range(len(out)):
        out[t] = q
        for _ in range(each):
            for stage in range(4):
                back = 0.0 if stage == 0 else (h if stage == 3 else 0.5 * h)
                for i in range(n):
                    qs[i] = q[i] + (back * kq[stage - 1, i] if stage else 0.0)
                    vs[i] = v[i] + (back * kv[stage - 1, i] if stage else 0.0)
                _shear(q, qs, z, law[GIVE], zs)
                kq[stage] = vs
                accelerations(qs, vs, zs, push[t], link, law, matrix, kv[stage])
            for i in range(n):
                qs[i] = q[i] + h / 6.0 * (kq[0, i] + 2.0 * kq[1, i] + 2.0 * kq[2, i] + kq[3, i])
                v[i] += h / 6.0 * (kv[0, i] + 2.0 * kv[1, i] + 2.0 * kv[2, i] + kv[3, i])
            _shear(q, qs, z, law[GIVE], zs)
            q[:] = qs
            z[:] = zs


@compiled
def _shear(before, after, z, give, out):
    """Friction is sheared by the turn of its joint until it slips."""
    turned = 0.0
    for i in range(len(z)):
        turn = after[i] - before[i]
        out[i] = min(max(z[i] + turn - turned, -give), give)
        turned = turn


@compiled
def shot(seen, start, moving, push, link, law, bias, step_s, each, rounds, prior, out):
    """Fit where a window starts (Gauss-Newton, `rounds`) and write what is left, measured minus swung, [T, n].

    seen: [T, n]; start: [2 n] a guess, changed into the fit; moving: [n] signs of the joints' rates at the start;
    prior: [2 n] weights that hold the start at the guess, against residuals of weight one.
    """
    size, n = seen.shape
    base, moved, shear = np.empty((size, n)), np.empty((size, n)), np.empty(n)
    columns, slope, guess = np.empty((2 * n, size * n)), np.empty(2 * n), start.copy()
    for k in range(rounds + 1):
        _start_shear(start, moving, link, law, shear)
        swing(start, shear, push, link, law, step_s, each, base)
        for t in range(size):
            for i in range(n):
                out[t, i] = seen[t, i] - base[t, i] - bias
        if k == rounds:
            break
        for d in range(2 * n):
            nudge = 1e-4 if d < n else 1e-3
            start[d] += nudge
            swing(start, shear, push, link, law, step_s, each, moved)
            start[d] -= nudge
            columns[d] = ((moved - base) / nudge).ravel()
        normal = columns @ columns.T
        for d in range(2 * n):
            normal[d, d] += prior[d]
            slope[d] = columns[d] @ out.ravel() - prior[d] * (start[d] - guess[d])
        _solve(normal, slope)
        start += slope


@compiled
def _start_shear(start, moving, link, law, shear):
    """Friction at the start: whole where a joint turns; where none does, what holds the chain where it hangs."""
    n = len(shear)
    below = 0.0
    for i in range(n - 1, -1, -1):
        below -= link[0, i] * law[GRAVITY] * math.sin(start[i])  # torque that this joint and those beyond must hold
        still = below / law[TORQUE] if law[TORQUE] > 0.0 else 0.0
        shear[i] = law[GIVE] * (moving[i] if moving[i] != 0.0 else min(max(still, -1.0), 1.0))
