"""Fits of many sets of effects at once by Gauss-Newton within bounds; each Jacobian is one batch of simulations.

Every fit includes the nuisance parameters, linear within their boxes. Held-out losses come from the fit's last
linearisation, solved again without each fold, or from simulations.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine import box
from softarm.diagnosis.engine.candidates import (
    Coordinates,
    EffectSet,
    FittedParameter,
    joined,
    parameters_of,
    point_of,
    split,
)
from softarm.diagnosis.engine.held_out import Block, BlockSums, fit_nuisances, simulated_losses
from softarm.diagnosis.engine.jackknife import covariance, ridge
from softarm.diagnosis.engine.view import Array, Point
from softarm.diagnosis.engine.whitened import Moments, Rows, WhitenedResidual

ROUNDS = 4
CONVERGED = 1e-3  # relative gain of the loss that ends a fit
NUDGE = 0.04  # finite difference, in sizes of a parameter
COARSE = 1.0  # the same for a descent over the small minima of a law with kinks
SHORTER = 0.3  # factor of a step that did not lower the loss
NOISE_SIGMAS = 2.0  # chance correlation of neighbours in white noise
LEAST_WIDTH = 1e-3  # smallest half interval, in sizes of a parameter
REACH = 2.0  # largest step of a round, in sizes of a parameter
# Cost of a usual change, in losses. It only decides directions that the data leave open (torque, weight and inertia
# scale alike): the smallest change is taken, so that each effect can be left out on its own.
PRIOR = 0.01
# The same for a nuisance at the edge of its box, which counts as three standard deviations. It only chooses among sizes
# of an effect that fit alike next to different nuisances.
EDGE_COST = 9.0


@dataclass(frozen=True, slots=True)
class Fit:
    """Result of fitting one set of effects."""

    effects: EffectSet
    u: Coordinates
    nuisance: Array  # [q] in units of the boxes' edges
    loss: float  # weighted squares of the whitened residual
    held_out: Array  # [B] loss of each block, from a fit without the block's fold
    folds: Array  # [F, p] coordinates from a fit without each fold
    # [F + 2, p] coordinates without each fold, then from each half of every trial, next to the nuisances of all data.
    apart: Array

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the effects."""
        return tuple(each.name for each in self.effects)

    @property
    def x(self) -> Array:
        """Return the coordinates of all parameters, [p]."""
        return joined(self.u)

    @property
    def point(self) -> Point:
        """Return the parameters in the registry's units."""
        return point_of(self.effects, self.u)

    @property
    def fold_points(self) -> list[Point]:
        """Return the parameters of each fit that left out one fold."""
        return [point_of(self.effects, split(self.effects, x)) for x in self.folds]

    def only(self, kept: Sequence[int]) -> tuple[EffectSet, Coordinates]:
        """Return some of the effects, by index, with their coordinates, as the start of another fit."""
        return tuple(self.effects[i] for i in kept), tuple(self.u[i] for i in kept)

    def scatter(self, i: int) -> float:
        """Return the jackknife error of an effect's strength across folds, relative to its change.

        It is small for a true effect. A law that only resembles the true one needs another strength in each fold.
        """
        at, change = self._strongest(i)
        values = self.apart[:-2, at]
        return float(np.sqrt((len(values) - 1) / len(values) * np.sum((values - values.mean()) ** 2)) / change)

    def drift(self, i: int) -> float:
        """Return the difference of an effect's strength between the trials' halves, relative to its change."""
        at, change = self._strongest(i)
        early, late = self.apart[-2:, at]
        return float(abs(late - early) / change)

    def _strongest(self, i: int) -> tuple[int, float]:
        """Return the index, among all parameters, and the change of the parameter that leaves its tolerance most."""
        parameters, us = self.effects[i].parameters, self.u[i]
        beyond = [(abs(u - p.nominal) - p.tolerance) / p.size for p, u in zip(parameters, us, strict=True)]
        j = beyond.index(max(beyond))
        at = sum(len(each.parameters) for each in self.effects[:i]) + j
        return at, max(abs(us[j] - parameters[j].nominal), 1e-9 * parameters[j].size)

    @property
    def at_bound(self) -> bool:
        """Return whether any effect is at a bound."""
        return any(each.at_bound(us) for each, us in zip(self.effects, self.u, strict=True))


class _Descent:
    """State of the descent of one set: the best coordinates and the next to try."""

    def __init__(self, effects: EffectSet, start: Array) -> None:
        self.effects, self.best, self.tried = effects, start, start
        self.loss, self.moving = np.inf, True
        self.jacobians: list[Rows] = []
        self.bases: list[Moments] = []
        self._step = np.zeros_like(start)

    def accept(self, loss: float) -> bool:
        """Keep the tried coordinates if their loss is the best so far, else shorten the step; return which."""
        if loss < self.loss or not self.bases:
            self.moving = not loss > self.loss * (1 - CONVERGED)
            self.best, self.loss = self.tried, loss
            return True
        self._step = SHORTER * self._step
        self.tried = self.best + self._step
        return False

    def advance(self, jacobians: list[Rows], bases: list[Moments], step: Array) -> None:
        """Try a step from the best coordinates, where this linearisation holds."""
        self.jacobians, self.bases, self._step = jacobians, bases, step
        self.moving = self.moving and bool(len(step))
        self.tried = self.best + step


@dataclass(frozen=True, slots=True)
class FitProblem:
    """Whitened residuals of all views, the boxes of the nuisances, and the fold of each block."""

    whitened: tuple[WhitenedResidual, ...]
    nuisance_paths: tuple[str, ...]  # [q]
    nuisance_low: Array  # [q] in units of the edges
    nuisance_high: Array
    blocks: tuple[Block, ...]  # [B]
    fold: NDArray[np.int64]  # [B]
    simulated: bool = False  # simulate held-out losses instead of using the last linearisation
    nudge: float = NUDGE  # finite difference, in sizes of a parameter
    edge_cost: float = 0.0  # cost of a nuisance at the edge of its box, in losses

    def fit(self, sets: Sequence[tuple[EffectSet, Coordinates]], rounds: int = ROUNDS) -> list[Fit]:
        """Fit every set from its start, all sets together.

        Each round simulates the losses of all sets, then the Jacobians of the sets that improved.
        """
        searches = [_Descent(effects, joined(u)) for effects, u in sets]
        for _ in range(rounds):
            moving = [each for each in searches if each.moving]
            if not moving:
                break
            losses = self._losses([d.effects for d in moving], [d.tried for d in moving])
            costs = [_cost(d.effects, d.tried) for d in moving]
            gained = [d for d, loss, cost in zip(moving, losses, costs, strict=True) if d.accept(loss + cost)]
            linear = self._linear([d.effects for d in gained], [d.best for d in gained])
            for descent, (jacobians, bases) in zip(gained, linear, strict=True):
                descent.advance(jacobians, bases, self.step(descent.effects, descent.best, jacobians, bases))
        return [self._fit(d.effects, d.best, d.loss, d.jacobians, d.bases) for d in searches]

    def losses(self, sets: Sequence[tuple[EffectSet, Coordinates]]) -> list[float]:
        """Return the losses of sets at given coordinates with fitted nuisances."""
        return self._losses([effects for effects, _ in sets], [joined(u) for _, u in sets])

    def sensitivities(self, fit: Fit) -> tuple[Array, Array]:
        """Return normal matrix [p + q, p + q] and slope [p + q] of a fit's parameters and the nuisances."""
        ((jacobians, bases),) = self._linear([fit.effects], [fit.x])
        return self._held_normal(fit.effects, fit.x, jacobians, bases)

    def block_squares(self, point: Point | None = None) -> Array:
        """Return the squares of the whitened residual in each block, [B], by default of the nominal model."""
        return np.asarray(BlockSums(self.whitened, self.blocks).residuals([point or {}])[0][0])

    def nuisance_box(self, effects: EffectSet) -> tuple[Array, Array]:
        """Return low and high [q] of the nuisances; a parameter that the set fits itself, or its twin, is fixed."""
        own = {path for d in parameters_of(effects) for path in (d.path, d.twin)}
        free = np.array([path not in own for path in self.nuisance_paths])
        return self.nuisance_low * free, self.nuisance_high * free

    def _moments(self, points: Sequence[Point]) -> list[list[Moments]]:
        """[view][point]."""
        return [residual.moments(points) for residual in self.whitened]

    def _losses(self, effects: Sequence[EffectSet], state: Sequence[Array]) -> list[float]:
        points = [point_of(e, split(e, x)) for e, x in zip(effects, state, strict=True)]
        moments = self._moments(points)
        gg = np.sum([residual.gg for residual in self.whitened], axis=0) + self.edge_cost * np.eye(
            len(self.nuisance_low)
        )
        result = []
        for i, each in enumerate(effects):
            rr, gr = sum(m[i].rr for m in moments), np.sum([m[i].gr for m in moments], axis=0)
            loss, _ = fit_nuisances(rr, gr, gg, self.nuisance_box(each))
            result.append(loss if np.isfinite(loss) else np.inf)
        return result

    def _linear(self, effects: Sequence[EffectSet], state: Sequence[Array]) -> list[tuple[list[Rows], list[Moments]]]:
        """Return the Jacobian ([p, N] or empty) and the moments of every set, by view."""
        points, nudges = [], []
        for each, x in zip(effects, state, strict=True):
            nudge = np.array([nudged(d, v, self.nudge) for d, v in zip(parameters_of(each), x, strict=True)])
            nudges.append(nudge)
            points.append([point_of(each, split(each, x + change)) for change in (0 * x, *np.diag(nudge))])
        flat = [p for ps in points for p in ps]
        moments, at, found = self._moments(flat), 0, []
        for ps, nudge in zip(points, nudges, strict=True):
            jacobians: list[Rows] = []
            bases: list[Moments] = []
            for residual_moments in moments:
                base = residual_moments[at]
                rows = [m.rows for m in residual_moments[at + 1 : at + len(ps)]]
                moved = any(row is not base.rows for row in rows)
                jacobians.append(
                    np.stack([(row - base.rows) / np.float32(n) for row, n in zip(rows, nudge, strict=True)])
                    if moved
                    else np.empty((0, 0), np.float32)
                )
                bases.append(base)
            found.append((jacobians, bases))
            at += len(ps)
        return found

    def step(self, effects: EffectSet, x: Array, jacobians: list[Rows], bases: list[Moments]) -> Array:
        """Return a Gauss-Newton step from x, with the nuisances fitted."""
        normal, slope = self._held_normal(effects, x, jacobians, bases)
        return np.asarray(box.solve(normal, -slope, *self._box(effects, x))[: len(x)])

    def _held_normal(
        self, effects: EffectSet, x: Array, jacobians: list[Rows], bases: list[Moments]
    ) -> tuple[Array, Array]:
        """Return normal matrix and slope of effects and nuisances, with the prior."""
        normal, slope = self._normal(len(x), jacobians, bases)
        self._add_priors(effects, x, normal, slope)
        return normal, slope

    def _add_priors(self, effects: EffectSet, x: Array, normal: Array, slope: Array) -> None:
        held, pull = _prior(effects, x)
        normal[range(len(normal)), range(len(normal))] += np.concatenate(
            (held, np.full(len(normal) - len(x), self.edge_cost))
        )
        slope[: len(x)] += pull

    def _normal(self, p: int, jacobians: list[Rows], bases: list[Moments]) -> tuple[Array, Array]:
        q = len(self.nuisance_low)
        normal, slope = np.zeros((p + q, p + q)), np.zeros(p + q)
        for residual, jacobian, base in zip(self.whitened, jacobians, bases, strict=True):
            normal[p:, p:] += residual.gg
            slope[p:] += base.gr
            if len(jacobian):
                normal[:p, :p] += jacobian @ jacobian.T
                across = residual.products(jacobian)
                normal[:p, p:] += across
                normal[p:, :p] += across.T
                slope[:p] += jacobian @ base.rows
        return normal, slope

    def _box(self, effects: EffectSet, x: Array) -> tuple[Array, Array]:
        parameters = parameters_of(effects)
        reach = [min(REACH * d.size, d.reach) for d in parameters]
        low = np.array([max(d.low - v, -most) for d, v, most in zip(parameters, x, reach, strict=True)])
        high = np.array([min(d.high - v, most) for d, v, most in zip(parameters, x, reach, strict=True)])
        nuisance_low, nuisance_high = self.nuisance_box(effects)
        return np.concatenate((low, nuisance_low)), np.concatenate((high, nuisance_high))

    def _fit(self, effects: EffectSet, x: Array, loss: float, jacobians: list[Rows], bases: list[Moments]) -> Fit:
        """Solve the last linearisation with all data, without each fold, and on each half of the trials."""
        normal, slope, squares = self._by_block(len(x), jacobians, bases)
        low, high = self._box(effects, x)
        total_normal, total_slope = normal.sum(axis=0), slope.sum(axis=0)
        self._add_priors(effects, x, total_normal, total_slope)
        best = box.solve(total_normal, -total_slope, low, high)
        lost, folds = np.empty(len(squares)), []
        for fold in np.unique(self.fold):
            out = self.fold == fold
            others = total_normal - normal[out].sum(axis=0), total_slope - slope[out].sum(axis=0)
            y = box.solve(others[0], -others[1], low, high)
            folds.append(x + y[: len(x)])
            lost[out] = squares[out] + 2 * slope[out] @ y + np.einsum("i,bij,j->b", y, normal[out], y)
        if self.simulated:
            sums = BlockSums(self.whitened, self.blocks)
            lost = simulated_losses(sums, self.fold, self.nuisance_box(effects), effects, x, np.array(folds))
        nuisance = best[len(x) :]
        return Fit(
            effects,
            split(effects, x),
            nuisance,
            loss - _cost(effects, x) - self.edge_cost * float(nuisance @ nuisance),  # without the priors
            lost,
            np.array(folds),
            self._apart(x, nuisance, normal, slope, low, high),
        )

    def _apart(self, x: Array, nuisance: Array, normal: Array, slope: Array, low: Array, high: Array) -> Array:
        """Return the coordinates [F + 2, p] from parts of the data, by the matrices and slopes of the blocks.

        A nuisance is as constant as the strength. Fitted to each part, the two would trade within its tolerance.
        """
        p, late = len(x), self._late()
        found = []
        for part in (*(self.fold != fold for fold in np.unique(self.fold)), ~late, late):
            matrix, pull = normal[part, :p].sum(axis=0), slope[part, :p].sum(axis=0)
            own, moved = np.ascontiguousarray(matrix[:, :p]), matrix[:, p:] @ nuisance
            found.append(x + box.solve(own, -(pull + moved), low[:p], high[:p]))
        return np.array(found)

    def part(self, fit: Fit, kept: Sequence[int]) -> Fit:
        """Return a fit with some of its effects, which keep their values; the nuisances are fitted again."""
        effects, u = fit.only(kept)
        owner = np.repeat(np.arange(len(fit.effects)), [len(each.parameters) for each in fit.effects])
        mine = np.isin(owner, kept)
        limits = self.nuisance_box(effects)
        moments = [each for (each,) in self._moments([point_of(effects, u)])]
        gg, gr = (np.sum(each, axis=0) for each in ([r.gg for r in self.whitened], [m.gr for m in moments]))
        loss, w = fit_nuisances(sum(m.rr for m in moments), gr, gg, limits)
        folds, sums = fit.folds[:, mine], BlockSums(self.whitened, self.blocks)
        lost = simulated_losses(sums, self.fold, limits, effects, joined(u), folds)
        return Fit(effects, u, w, loss, lost, folds, fit.apart[:, mine])

    def linear(self, fit: Fit) -> tuple[Array, Array, Array, Array]:
        """Return a fit's linearisation: normal matrices [B, n, n] and slopes [B, n] of the blocks, low and high [n].

        The n unknowns are the steps of the effects' p parameters, then the nuisances in units of their edges.
        """
        ((jacobians, bases),) = self._linear([fit.effects], [fit.x])
        normal, slope, _ = self._by_block(len(fit.x), jacobians, bases)
        return normal, slope, *self._box(fit.effects, fit.x)

    def interval(self, fit: Fit, inexact: bool = False) -> tuple[Array, Array]:
        """Return the 95 % interval of a fit's parameters, low and high, [p] each; arguments as for `region`.

        Of sizes that fit alike next to the nuisances, a fit may state another one than the best of its linearisation.
        Both are uncertain by as much.
        """
        x, best, spread = self.region(fit, inexact)
        least = LEAST_WIDTH * np.array([d.size for d in parameters_of(fit.effects)])
        half = np.maximum(np.sqrt(spread.diagonal()), least)
        return np.minimum(best, x) - half, np.maximum(best, x) + half

    def region(self, fit: Fit, inexact: bool = False) -> tuple[Array, Array, Array]:
        """Return a fit's parameters [p], those of its last linearisation [p], and their covariance, [p, p].

        The root of the covariance's diagonal is half the 95 % interval.

        Args:
            fit: fit whose parameters are meant.
            inexact: widen the region by the law error that the residual may hide.
        """
        x, p = fit.x, len(fit.x)
        if not p:
            return x, x, np.zeros((0, 0))
        ((jacobians, bases),) = self._linear([fit.effects], [x])
        normal, slope, _ = self._by_block(p, jacobians, bases)
        low, high = self._box(fit.effects, x)
        best = box.solve(normal.sum(axis=0), -slope.sum(axis=0), low, high)
        free = (best > low + 1e-9) & (best < high - 1e-9)  # nuisances at an edge stay there
        free[:p] = True
        slope = slope + normal[:, :, ~free] @ best[~free]
        spread = covariance(normal[:, free][:, :, free], slope[:, free], best[free])[:p, :p]
        if inexact:
            spread = spread + self._law_error(fit.effects, best, normal.sum(axis=0), jacobians, bases)
        return x, x + best[:p], spread

    def _law_error(
        self, effects: EffectSet, best: Array, normal: Array, jacobians: list[Rows], bases: list[Moments]
    ) -> Array:
        """Return the parameters' squared errors [p, p] if the residual hides a law that resembles an effect.

        Only the autocorrelated part of the residual counts; noise has none but by chance. The nuisances yield within
        their boxes. best: [p + q] minimum of the last linearisation; normal: its matrix.
        """
        p, carried, chance = len(best) - len(self.nuisance_low), 0.0, 0.0
        for residual, jacobian, base in zip(self.whitened, jacobians, bases, strict=True):
            rows = base.rows + best[p:] @ residual.columns + (best[:p] @ jacobian if len(jacobian) else 0.0)
            width = residual.gaps.view.measured.shape[1]
            for _, part in residual.blocks:
                products = rows[part][width:] * rows[part][:-width]
                carried, chance = carried + float(products.sum()), chance + float(products @ products)
        left = max(carried - NOISE_SIGMAS * chance**0.5, 0.0)
        reach = np.max(np.abs(self.nuisance_box(effects)), axis=0)
        kept = np.concatenate((np.ones(p, dtype=bool), reach > 0))
        held = normal[kept][:, kept] + np.diag(np.concatenate((np.zeros(p), left / reach[reach > 0] ** 2)))
        held += ridge(held) * np.eye(len(held))
        return np.asarray(left * np.linalg.inv(held)[:p, :p])

    def _late(self) -> NDArray[np.bool_]:
        """Return which blocks are in the second half of their trial, [B]."""
        last: dict[int, int] = {}
        for trial, number in self.blocks:
            last[trial] = max(last.get(trial, 0), number)
        return np.array([2 * number > last[trial] for trial, number in self.blocks])

    def _by_block(self, p: int, jacobians: list[Rows], bases: list[Moments]) -> tuple[Array, Array, Array]:
        """Return normal matrices [B, p + q, p + q], slopes [B, p + q] and squares [B] of the blocks."""
        size, q = len(self.blocks), len(self.nuisance_low)
        normal, slope, squares = np.zeros((size, p + q, p + q)), np.zeros((size, p + q)), np.zeros(size)
        place = {name: i for i, name in enumerate(self.blocks)}
        for residual, jacobian, base in zip(self.whitened, jacobians, bases, strict=True):
            at = [place[name] for name, _ in residual.blocks]
            rows = np.concatenate((jacobian, base.rows[None])) if len(jacobian) else base.rows[None]
            own, across = residual.block_products(rows)  # the residual comes last
            normal[at, p:, p:] += residual.block_gg
            slope[at, p:] += across[:, -1]
            squares[at] += own[:, -1, -1]
            if len(jacobian):
                normal[at, :p, :p] += own[:, :p, :p]
                normal[at, :p, p:] += across[:, :p]
                normal[at, p:, :p] += across[:, :p].transpose(0, 2, 1)
                slope[at, :p] += own[:, :p, -1]
        return normal, slope, squares


def nudged(parameter: FittedParameter, u: float, share: float) -> float:
    """Return a signed finite difference of a share of a parameter's size, within the wider side of its bounds.

    A parameter that is fixed by equal bounds gets the whole share.
    """
    up, down = parameter.high - u, u - parameter.low
    wanted = share * parameter.size
    if wanted <= up or parameter.high <= parameter.low:
        return wanted
    return -min(wanted, down) if down >= up else up


def _prior(effects: EffectSet, x: Array) -> tuple[Array, Array]:
    """Return diagonal [p] and slope [p] of the prior on changes."""
    parameters = parameters_of(effects)
    held = np.array([PRIOR / d.size**2 for d in parameters])
    return held, held * (x - np.array([d.nominal for d in parameters]))


def _cost(effects: EffectSet, x: Array) -> float:
    held, pull = _prior(effects, x)
    return float(pull @ (pull / held))
