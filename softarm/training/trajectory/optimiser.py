"""Augmented-Lagrangian Gauss-Newton on knots of commands, for many plans at once.

The seed uses iLQR with an augmented Lagrangian; this is its single-shooting form. The damped arm makes single shooting
safe: the effect of an early command on a late step does not grow without bound. A Jacobian is a batch of roll-outs on
the simulator, one per knot, so plans include every effect of a model. See docs/training/trajectory.md.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from softarm.schemas.robot import CONTROL_RATE_HZ
from softarm.training.trajectory import problem
from softarm.training.trajectory.problem import Array, Motion, Rollouts, interpolation

Mask = NDArray[np.bool_]

# Unit of each command's knots, and the step of a finite difference, far above the rounding of single precision.
UNIT = np.array([1.0, 10.0], dtype=np.float32)
NUDGE = np.float32(0.02)
COST_SCALE = np.float32(1e-4)  # of the whole objective, so that the penalties' weights are near 1
PENALTY_FIRST, PENALTY_GROWTH, PENALTY_LAST = 10.0, 4.0, 1e4
OUTER, INNER = 5, 4
# A plan is done within these limits, after a round that changed its objective by less than a share.
MISS_M, BEYOND_M, RAMP_M_S, COST_SHARE = 0.003, 0.001, 0.01, 0.05
DAMPINGS = np.array([0.03, 0.3, 3.0, 30.0], dtype=np.float32)


class Batch(NamedTuple):
    """Targets, starts and lengths, one entry per plan."""

    target_m: Array  # [P, 2]
    cart_start_m: Array  # [P]
    steps: NDArray[np.int64]  # [P], N: the tip must be on the target after so many

    def part(self, which: NDArray[np.int64]) -> "Batch":
        """Return some of the plans."""
        return Batch(self.target_m[which], self.cart_start_m[which], self.steps[which])


class Solution(NamedTuple):
    """Solution of P plans."""

    knots: Array  # [P, knots, 2] in m/s and kPa
    cost: Array  # [P], the objective
    miss_m: Array  # [P], distance of the tip from the target at the last step
    beyond_m: Array  # [P], how far the cart passes its limit


class _Terms(NamedTuple):
    """Terms of the merit function of V variants of P plans."""

    cost: Array  # [V, P]
    tip: Array  # [V, P, 2], from the target: = 0
    rail: Array  # [V, P, 2, T]: <= 0
    ramp: Array  # [V, P, 2, knots - 1]: <= 0


class Optimiser:
    """Optimiser of one batch of plans, from which finished plans are removed."""

    def __init__(self, rollouts: Rollouts, batch: Batch) -> None:
        self._rollouts, self._batch = rollouts, batch
        self._steps = int(batch.steps.max())
        self._spread = interpolation(self._steps)
        self._knots = self._spread.shape[1]
        self._plans = len(batch.steps)
        self._low = np.array([-problem.VELOCITY_MAX_M_S, problem.PRESSURE_MIN_KPA], dtype=np.float32) / UNIT
        self._high = np.array([problem.VELOCITY_MAX_M_S, problem.PRESSURE_MAX_KPA], dtype=np.float32) / UNIT
        self._ramp_max = np.float32(problem.ACCELERATION_MAX_M_S2 * problem.KNOT_STEPS / CONTROL_RATE_HZ / UNIT[0])
        self._on = np.arange(1, self._steps + 1) <= batch.steps[:, None]  # [P, T]: steps of each plan
        self._nominal = rollouts.settled_pose(problem.NOMINAL_PRESSURE_KPA)
        self._state_weight = self._square_roots_of_q()
        self._quadratic = self._quadratic_form_of_r()

    def _square_roots_of_q(self) -> Array:
        """Return the square roots of the objective's weights on states, [P, T, S]."""
        n = self._rollouts.model.arm.links
        positions = np.concatenate(([1, 0], np.ones(n), np.zeros(n)))
        running = problem.POSITION_WEIGHT * positions + problem.RATE_WEIGHT * (1 - positions)
        final = problem.FINAL_POSITION_WEIGHT * positions + problem.FINAL_RATE_WEIGHT * (1 - positions)
        weight = self._on[:, :, None] * running
        weight[np.arange(self._plans), self._batch.steps - 1] = final
        return np.sqrt(weight * COST_SCALE).astype(np.float32)

    def _quadratic_form_of_r(self) -> Array:
        """Return the quadratic form [P, 2 K, 2 K] of the commands in the objective; they are linear in the knots."""
        change = np.diff(self._spread, axis=0, prepend=0.0)
        change[0] = self._spread[0]  # from rest
        force = change * np.float32(problem.MOVED_MASS_KG * CONTROL_RATE_HZ * UNIT[0] * np.sqrt(problem.FORCE_WEIGHT))
        press = self._spread * np.float32(UNIT[1] / 10.0 * np.sqrt(problem.PRESSURE_WEIGHT))
        form = np.zeros((self._plans, 2 * self._knots, 2 * self._knots), dtype=np.float32)
        for c, rows in enumerate((force, press)):
            form[:, c::2, c::2] = np.einsum("ti,pt,tj->pij", rows, self._on.astype(np.float32), rows) * COST_SCALE
        return form

    # -- roll-outs

    def _fly(self, knots: Array) -> Motion:
        """Fly knots [V, P, 2 K] (units, not physical): V variants of each plan. Robots are variant-major."""
        variants = len(knots)
        shaped = knots.reshape(variants * self._plans, self._knots, 2) * UNIT
        commands = np.tensordot(self._spread, shaped, (1, 1))
        return self._rollouts.fly(commands, np.tile(self._batch.cart_start_m, variants))

    def _terms(self, knots: Array, motion: Motion) -> _Terms:
        """Return objective and constraints of variants [V, P, 2 K]."""
        v, p = len(knots), self._plans
        state = motion.state[1:].reshape(self._steps, v, p, -1)
        deviation = (state - self._nominal).transpose(1, 2, 0, 3) * self._state_weight
        cost = np.einsum("vpts,vpts->vp", deviation, deviation)
        cost += np.einsum("vpi,pij,vpj->vp", knots, self._quadratic, knots)
        tip = motion.tip_m.reshape(self._steps + 1, v, p, 2)[self._batch.steps, :, np.arange(p)].transpose(1, 0, 2)
        reserve = problem.stopping_m(state[..., 0], state[..., 1]).transpose(1, 2, 0)
        limit = np.float32(problem.RAIL_MAX_M)
        beyond = np.stack((reserve - limit, -reserve - limit), axis=2)
        rail = np.where(self._on[:, None], beyond, np.float32(-1.0))  # kept after a plan's end
        change = np.diff(knots[..., 0::2], axis=-1)  # of velocity, from knot to knot
        ramp = np.stack((change - self._ramp_max, -change - self._ramp_max), axis=2)
        return _Terms(cost, tip - self._batch.target_m, rail, ramp)

    # -- the method

    def solve(self, knots_physical: Array) -> Solution:
        """Improve knots [P, >= knots, 2] until each plan is done, or for OUTER x INNER iterations; runs once."""
        # Start within the bounds; every later step stays there.
        knots = np.clip(knots_physical[:, : self._knots] / UNIT, self._low, self._high).reshape(self._plans, -1)
        penalty = np.full(self._plans, PENALTY_FIRST, dtype=np.float32)
        damping = np.full(self._plans, 1e-2, dtype=np.float32)
        terms = self._terms(knots[None], self._fly(knots[None]))
        multipliers = tuple(np.zeros_like(each[0]) for each in terms[1:])
        whole, left = self._solution(knots, terms), np.arange(self._plans)
        for _ in range(OUTER):
            for _ in range(INNER):
                knots, damping, terms = self._iterate(knots, damping, penalty, multipliers)
            multipliers = _raised(multipliers, penalty, terms)
            penalty = np.minimum(penalty * PENALTY_GROWTH, PENALTY_LAST).astype(np.float32)
            found = self._solution(knots, terms)
            kept = np.flatnonzero(~_done(found, terms, whole.cost[left]))
            for all_plans, values in zip(whole, found, strict=True):
                all_plans[left] = values
            if not kept.size:
                break
            left = left[kept]
            self._narrow(kept)
            knots, damping, penalty = knots[kept], damping[kept], penalty[kept]
            multipliers = tuple(each[kept] for each in multipliers)
        return whole

    def _narrow(self, kept: NDArray[np.int64]) -> None:
        """Continue with some of the plans."""
        self._batch, self._plans = self._batch.part(kept), len(kept)
        self._on, self._state_weight = self._on[kept], self._state_weight[kept]
        self._quadratic = self._quadratic[kept]

    def _solution(self, knots: Array, terms: _Terms) -> Solution:
        return Solution(
            knots.reshape(self._plans, self._knots, 2) * UNIT,
            terms.cost[0] / COST_SCALE,
            np.hypot(terms.tip[0, :, 0], terms.tip[0, :, 1]),
            np.maximum(terms.rail[0].max(axis=(1, 2)), 0.0),
        )

    def _merit(self, terms: _Terms, penalty: Array, multipliers: tuple[Array, ...]) -> Array:
        """Return the augmented Lagrangian, [V, P]."""
        tip, rail, ramp = multipliers
        weight = penalty[:, None]
        total = terms.cost + (0.5 * weight * (terms.tip + tip / weight) ** 2).sum(axis=-1)
        weight = penalty[:, None, None]
        for value, multiplier in ((terms.rail, rail), (terms.ramp, ramp)):
            total = total + (0.5 * weight * np.maximum(value + multiplier / weight, 0.0) ** 2).sum(axis=(-1, -2))
        merit: Array = np.where(np.isfinite(total), total, np.inf)
        return merit

    def _iterate(
        self, knots: Array, damping: Array, penalty: Array, multipliers: tuple[Array, ...]
    ) -> tuple[Array, Array, _Terms]:
        """Take a Gauss-Newton step with the best of several dampings."""
        hessian, gradient = self._model(knots, penalty, multipliers)
        tries = damping * DAMPINGS[:, None]  # [V, P]
        candidates = np.stack([self._step(knots, hessian, gradient, each) for each in tries])
        candidates = np.concatenate((knots[None], candidates))
        terms = self._terms(candidates, self._fly(candidates))
        merit = self._merit(terms, penalty, multipliers)
        best, plans = merit.argmin(axis=0), np.arange(self._plans)
        damping = np.where(best == 0, damping * 30.0, tries[best - 1, plans]).clip(1e-3, 1e4).astype(np.float32)
        chosen = _Terms(*(each[best, plans][None] for each in terms))
        return candidates[best, plans], damping, chosen

    def _model(self, knots: Array, penalty: Array, multipliers: tuple[Array, ...]) -> tuple[Array, Array]:
        """Return Gauss-Newton matrix [P, 2K, 2K] and gradient [P, 2K] of the augmented Lagrangian."""
        unknowns, plans = 2 * self._knots, self._plans
        variants = np.repeat(knots[None], 1 + unknowns, axis=0)
        variants[np.arange(1, 1 + unknowns), :, np.arange(unknowns)] += NUDGE
        motion = self._fly(variants)
        base = Motion(*(each[:, :plans] for each in motion))
        now = self._terms(knots[None], base)
        state = motion.state[1:].reshape(self._steps, 1 + unknowns, plans, -1)
        slope = (state[:, 1:] - state[:, :1]).transpose(2, 0, 3, 1) / NUDGE  # [P, T, S, C]
        weighted = (slope * self._state_weight[..., None]).reshape(plans, -1, unknowns)
        deviation = ((state[:, 0] - self._nominal).transpose(1, 0, 2) * self._state_weight).reshape(plans, -1)
        hessian = 2 * (weighted.transpose(0, 2, 1) @ weighted + self._quadratic)
        gradient = 2 * (np.einsum("pmc,pm->pc", weighted, deviation) + np.einsum("pij,pj->pi", self._quadratic, knots))

        tip_multiplier, rail_multiplier, ramp_multiplier = multipliers
        tips = motion.tip_m.reshape(self._steps + 1, 1 + unknowns, plans, 2)[self._batch.steps, :, np.arange(plans)]
        lever = ((tips[:, 1:] - tips[:, :1]) / NUDGE).transpose(0, 2, 1)  # [P, 2, C]
        always = np.ones((plans, 2), dtype=np.bool_)
        self._add(hessian, gradient, lever, now.tip[0], tip_multiplier, penalty, always)

        speed = np.abs(state[:, 0, :, 1]).T[..., None] / np.float32(problem.BRAKING_M_S2)
        place = slope[:, :, 0] + speed * slope[:, :, 1]  # [P, T, C]
        change = np.zeros((self._knots - 1, unknowns), dtype=np.float32)
        change[np.arange(self._knots - 1), 2 * np.arange(self._knots - 1)] = -1.0
        change[np.arange(self._knots - 1), 2 * np.arange(1, self._knots)] = 1.0
        for side, sign in enumerate((1.0, -1.0)):
            ramps = np.broadcast_to(sign * change, (plans, *change.shape))
            for value, multiplier, rows in (
                (now.rail[0, :, side], rail_multiplier[:, side], sign * place),
                (now.ramp[0, :, side], ramp_multiplier[:, side], ramps),
            ):
                active = value + multiplier / penalty[:, None] > 0
                self._add(hessian, gradient, rows.astype(np.float32), value, multiplier, penalty, active)
        return hessian, gradient

    @staticmethod
    def _add(
        hessian: Array, gradient: Array, rows: Array, value: Array, multiplier: Array, penalty: Array, active: Mask
    ) -> None:
        """Add a constraint's share, in place."""
        rows = rows * active[..., None]
        hessian += penalty[:, None, None] * (rows.transpose(0, 2, 1) @ rows)
        pull = (penalty[:, None] * value + multiplier) * active
        gradient += np.einsum("pmc,pm->pc", rows, pull)

    def _step(self, knots: Array, hessian: Array, gradient: Array, damping: Array) -> Array:
        """Return the knots after a damped step; knots at a bound with an outward gradient stay."""
        low, high = np.tile(self._low, self._knots), np.tile(self._high, self._knots)
        held = ((knots <= low) & (gradient > 0)) | ((knots >= high) & (gradient < 0))
        free = (~held).astype(np.float32)
        matrix = (hessian * free[:, :, None] * free[:, None, :]).astype(np.float64)
        diagonal = np.arange(matrix.shape[1])
        matrix[:, diagonal, diagonal] += damping[:, None] + (1.0 - free)
        step = np.linalg.solve(matrix, (-gradient * free)[..., None].astype(np.float64))[..., 0]
        return np.clip(knots + step.astype(np.float32), low, high)


def _raised(multipliers: tuple[Array, ...], penalty: Array, terms: _Terms) -> tuple[Array, ...]:
    """Return the multipliers after a round, bounded: a target out of reach would pull them without end."""
    raised = [
        each + penalty.reshape(-1, *(1 for _ in each.shape[1:])) * value[0]
        for each, value in zip(multipliers, terms[1:], strict=True)
    ]
    return tuple(np.clip(each, low, 30.0) for each, low in zip(raised, (-30.0, 0.0, 0.0), strict=True))


def _done(found: Solution, terms: _Terms, cost_before: Array) -> Mask:
    """Return which plans keep their constraints and cost hardly less than a round before, [P]."""
    near = (found.miss_m <= MISS_M) & (found.beyond_m <= BEYOND_M) & (terms.ramp[0].max(axis=(1, 2)) <= RAMP_M_S)
    done: Mask = near & (np.abs(found.cost - cost_before) <= COST_SHARE * found.cost)
    return done
