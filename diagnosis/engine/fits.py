"""Fits of nested sets of effects, many at once: Gauss-Newton in a box, every Jacobian a batch of simulated robots.

Beside a set's own parameters every fit has the nuisances, linear within their boxes. Held-out losses come from the
fit's last linearisation, solved anew without each fold, or are simulated there.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine import box, held_out
from softarm.diagnosis.engine.candidates import Set, U, point_of, split
from softarm.diagnosis.engine.jackknife import RIDGE, half_width
from softarm.diagnosis.engine.view import Array, Point
from softarm.diagnosis.engine.whitened import Moments, Rows, WhitenedResidual

ROUNDS = 4
CONVERGED = 1e-3  # of the loss: a round that gains less is the last
NUDGE = 0.04  # of a parameter's size, for a column of the Jacobian
SHORTER = 0.3  # of a step that did not help
NOISE_SIGMAS = 2.0  # of what neighbours in white noise have in common by chance
LEAST_WIDTH = 1e-3  # of a parameter's size: stamps, steps and laws are no better, however still the recording is
REACH = 2.0  # of a parameter's size: how far a round may go
# What a usual change costs, in losses: next to nothing. Where data leave a direction open (torques, weight and inertia
# all larger by the same share move alike) the smallest changes are taken, so that each can be spared for itself.
PRIOR = 0.01


@dataclass(frozen=True, slots=True)
class Fit:
    """A set of effects, fitted."""

    effects: Set
    u: U
    nuisance: Array  # [q] in units of the boxes' edges
    loss: float  # weighted squares of the whitened residual
    held_out: Array  # [B] the same, by block, each from a fit without the block's fold
    folds: Array  # [F, p] coordinates from a fit without each fold
    halves: Array  # [2, p] coordinates from every trial's first half alone, and from the second

    @property
    def names(self) -> tuple[str, ...]:
        """Of the effects."""
        return tuple(each.name for each in self.effects)

    @property
    def point(self) -> Point:
        """The registry's parameters."""
        return point_of(self.effects, self.u)

    @property
    def fold_points(self) -> list[Point]:
        """As `point`, from a fit without each fold."""
        return [point_of(self.effects, split(self.effects, x)) for x in self.folds]

    def scatter(self, i: int) -> float:
        """How far an effect's strength differs from one kind of excitation to another: jackknife error over the change.

        Of an effect that is there it is small; a law that only resembles the true one needs another strength each time.
        """
        at, change = self._strongest(i)
        values = self.folds[:, at]
        return float(np.sqrt((len(values) - 1) / len(values) * np.sum((values - values.mean()) ** 2)) / change)

    def drift(self, i: int) -> float:
        """How far an effect's strength differs between the trials' halves, over the change: one that grows or fades."""
        at, change = self._strongest(i)
        early, late = self.halves[:, at]
        return float(abs(late - early) / change)

    def _strongest(self, i: int) -> tuple[int, float]:
        """Of an effect's parameters the one furthest off for its size: its place among all, and how far off it is."""
        parameters, us = self.effects[i].parameters, self.u[i]
        j = max(range(len(parameters)), key=lambda k: abs(us[k] - parameters[k].nominal) / parameters[k].size)
        at = sum(len(each.parameters) for each in self.effects[:i]) + j
        return at, max(abs(us[j] - parameters[j].nominal), 1e-9 * parameters[j].size)

    @property
    def is_news(self) -> bool:
        """Whether every effect is."""
        return all(each.is_news(us) for each, us in zip(self.effects, self.u, strict=True))

    @property
    def at_bound(self) -> bool:
        """Whether any effect is."""
        return any(each.at_bound(us) for each, us in zip(self.effects, self.u, strict=True))


class _Descent:
    """One set's way down: where it is best, where it looks next."""

    def __init__(self, effects: Set, start: Array) -> None:
        self.effects, self.best, self.tried = effects, start, start
        self.loss, self.moving = np.inf, True
        self.jacobians: list[Rows] = []
        self.bases: list[Moments] = []
        self._step = np.zeros_like(start)

    def gains(self, loss: float) -> bool:
        """Whether the loss where it looks is the best so far; else it looks closer to the best."""
        if loss < self.loss or not self.bases:
            self.moving = not loss > self.loss * (1 - CONVERGED)
            self.best, self.loss = self.tried, loss
            return True
        self._step = SHORTER * self._step
        self.tried = self.best + self._step
        return False

    def go_on(self, jacobians: list[Rows], bases: list[Moments], step: Array) -> None:
        """Look a step further, from the best, where these were found."""
        self.jacobians, self.bases, self._step = jacobians, bases, step
        self.moving = self.moving and bool(len(step))
        self.tried = self.best + step


@dataclass(frozen=True, slots=True)
class FitProblem:
    """Whitened residuals of all views, the nuisances' boxes, and which fold each block is in."""

    whitened: tuple[WhitenedResidual, ...]
    nuisance_paths: tuple[str, ...]  # [q] of the registry, or a single joint's, which no effect replaces
    nuisance_low: Array  # [q] in units of the edges
    nuisance_high: Array
    blocks: tuple[tuple[int, int], ...]  # [B] trial, number
    fold: NDArray[np.int64]  # [B]
    simulated: bool = False  # whether held-out losses are simulated; else from the last linearisation

    def fit(self, sets: Sequence[tuple[Set, U]], rounds: int = ROUNDS) -> list[Fit]:
        """Fit every set from its start; all of them advance together, each round two batches of simulations.

        The first says who gained; only for those a Jacobian is simulated.
        """
        searches = [_Descent(effects, np.array([x for us in u for x in us])) for effects, u in sets]
        for _ in range(rounds):
            moving = [each for each in searches if each.moving]
            if not moving:
                break
            losses = self._losses([d.effects for d in moving], [d.tried for d in moving])
            costs = [_cost(d.effects, d.tried) for d in moving]
            gained = [d for d, loss, cost in zip(moving, losses, costs, strict=True) if d.gains(loss + cost)]
            linear = self._linear([d.effects for d in gained], [d.best for d in gained])
            for descent, (jacobians, bases) in zip(gained, linear, strict=True):
                descent.go_on(jacobians, bases, self.step(descent.effects, descent.best, jacobians, bases))
        return [self._fit(d.effects, d.best, d.loss, d.jacobians, d.bases) for d in searches]

    def losses(self, sets: Sequence[tuple[Set, U]]) -> list[float]:
        """Of sets at given coordinates, the nuisances fitted."""
        return self._losses([effects for effects, _ in sets], [np.array([x for us in u for x in us]) for _, u in sets])

    def left_out(self, fit: Fit) -> list[tuple[Set, U]]:
        """A set without each of its effects, the others where a line says that they take over what it explained."""
        x = np.array([v for us in fit.u for v in us])
        p, found, first = len(x), [], 0
        ((jacobians, bases),) = self._linear([fit.effects], [x])
        normal, slope = self._held_normal(fit.effects, x, jacobians, bases)
        parameters = [d for each in fit.effects for d in each.parameters]
        low, high = self._box(fit.effects, x)  # as far as the bounds go: nothing here is small
        low[:p], high[:p] = (np.array([getattr(d, end) for d in parameters]) - x for end in ("low", "high"))
        for i, each in enumerate(fit.effects):
            gone = np.arange(first, first + len(each.parameters))
            back = np.array([d.nominal for d in each.parameters]) - x[gone]
            rest = np.delete(np.arange(len(slope)), gone)
            wanted = -(slope[rest] + normal[np.ix_(rest, gone)] @ back)
            change = box.solve(np.ascontiguousarray(normal[np.ix_(rest, rest)]), wanted, low[rest], high[rest])
            others = fit.effects[:i] + fit.effects[i + 1 :]
            found.append((others, split(others, np.delete(x, gone) + change[: p - len(gone)])))
            first += len(gone)
        return found

    def nuisance_box(self, effects: Set) -> tuple[Array, Array]:
        """Box of the nuisances beside a set: what the set fits itself is no nuisance."""
        own = {d.path for each in effects for d in each.parameters}
        free = np.array([path not in own for path in self.nuisance_paths])
        return self.nuisance_low * free, self.nuisance_high * free

    def _moments(self, points: Sequence[Point]) -> list[list[Moments]]:
        """[view][point]."""
        return [residual.moments(points) for residual in self.whitened]

    def _losses(self, effects: Sequence[Set], state: Sequence[Array]) -> list[float]:
        points = [point_of(e, split(e, x)) for e, x in zip(effects, state, strict=True)]
        moments = self._moments(points)
        gg = sum(residual.gg for residual in self.whitened)
        result = []
        for i, each in enumerate(effects):
            rr, gr = sum(m[i].rr for m in moments), sum(m[i].gr for m in moments)
            w = box.solve(gg, -gr, *self.nuisance_box(each))
            loss = rr + 2 * w @ gr + w @ gg @ w
            result.append(float(loss) if np.isfinite(loss) else np.inf)
        return result

    def _linear(self, effects: Sequence[Set], state: Sequence[Array]) -> list[tuple[list[Rows], list[Moments]]]:
        """For every set: Jacobian by view ([p, N] or empty) and moments by view."""
        points, nudges = [], []
        for each, x in zip(effects, state, strict=True):
            parameters = [d for c in each for d in c.parameters]
            away = [1 if v + NUDGE * d.size <= d.high else -1 for d, v in zip(parameters, x, strict=True)]
            nudge = np.array([NUDGE * d.size * sign for d, sign in zip(parameters, away, strict=True)])
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

    def step(self, effects: Set, x: Array, jacobians: list[Rows], bases: list[Moments]) -> Array:
        """A Gauss-Newton step from x, the nuisances moving along."""
        normal, slope = self._held_normal(effects, x, jacobians, bases)
        return np.asarray(box.solve(normal, -slope, *self._box(effects, x))[: len(x)])

    def _held_normal(self, effects: Set, x: Array, jacobians: list[Rows], bases: list[Moments]) -> tuple[Array, Array]:
        """Normal matrix and slope of the effects and the nuisances, with what changes cost."""
        p = len(x)
        normal, slope = self._normal(p, jacobians, bases)
        held, pull = _prior(effects, x)
        normal[range(p), range(p)] += held
        slope[:p] += pull
        return normal, slope

    def _normal(self, p: int, jacobians: list[Rows], bases: list[Moments]) -> tuple[Array, Array]:
        q = len(self.nuisance_low)
        normal, slope = np.zeros((p + q, p + q)), np.zeros(p + q)
        for residual, jacobian, base in zip(self.whitened, jacobians, bases, strict=True):
            normal[p:, p:] += residual.gg
            slope[p:] += base.gr
            if len(jacobian):
                normal[:p, :p] += jacobian @ jacobian.T
                across = jacobian @ residual.columns.T
                normal[:p, p:] += across
                normal[p:, :p] += across.T
                slope[:p] += jacobian @ base.rows
        return normal, slope

    def _box(self, effects: Set, x: Array) -> tuple[Array, Array]:
        parameters = [d for c in effects for d in c.parameters]
        low = np.array([max(d.low - v, -REACH * d.size) for d, v in zip(parameters, x, strict=True)])
        high = np.array([min(d.high - v, REACH * d.size) for d, v in zip(parameters, x, strict=True)])
        nuisance_low, nuisance_high = self.nuisance_box(effects)
        return np.concatenate((low, nuisance_low)), np.concatenate((high, nuisance_high))

    def _fit(self, effects: Set, x: Array, loss: float, jacobians: list[Rows], bases: list[Moments]) -> Fit:
        """Solve the last linearisation with all data, without each fold, and on each half of the trials."""
        normal, slope, squares = self._by_block(len(x), jacobians, bases)
        low, high = self._box(effects, x)
        total_normal, total_slope = normal.sum(axis=0), slope.sum(axis=0)
        held, pull = _prior(effects, x)
        total_normal[range(len(x)), range(len(x))] += held
        total_slope[: len(x)] += pull
        best = box.solve(total_normal, -total_slope, low, high)
        lost, folds = np.empty(len(squares)), []
        for fold in np.unique(self.fold):
            out = self.fold == fold
            others = total_normal - normal[out].sum(axis=0), total_slope - slope[out].sum(axis=0)
            y = box.solve(others[0], -others[1], low, high)
            folds.append(x + y[: len(x)])
            lost[out] = squares[out] + 2 * slope[out] @ y + np.einsum("i,bij,j->b", y, normal[out], y)
        if self.simulated:
            lost = held_out.held_out(self, effects, x, np.array(folds))
        late = self._late()
        halves = []
        for part in (~late, late):
            y = box.solve(normal[part].sum(axis=0), -slope[part].sum(axis=0), low, high)
            halves.append(x + y[: len(x)])
        nuisance = best[len(x) :]
        return Fit(
            effects,
            split(effects, x),
            nuisance,
            loss - float(pull @ (pull / held)),  # the data's alone
            lost,
            np.array(folds),
            np.array(halves),
        )

    def interval(self, fit: Fit, inexact: bool = False) -> tuple[Array, Array]:
        """95 % interval of a fit's parameters, low and high [p]: what other blocks of the same kind would have said.

        inexact: the laws resemble the truth at best, so that the interval reaches as far as `_hidden` says besides.
        """
        x = np.array([v for us in fit.u for v in us])
        p = len(x)
        if not p:
            return x, x
        ((jacobians, bases),) = self._linear([fit.effects], [x])
        normal, slope, _ = self._by_block(p, jacobians, bases)
        low, high = self._box(fit.effects, x)
        sizes = np.array([d.size for each in fit.effects for d in each.parameters])
        best = box.solve(normal.sum(axis=0), -slope.sum(axis=0), low, high)
        free = (best > low + 1e-9) & (best < high - 1e-9)  # a nuisance at its box's edge stays there
        free[:p] = True
        slope = slope + normal[:, :, ~free] @ best[~free]
        half = half_width(normal[:, free][:, :, free], slope[:, free], best[free])[:p]
        if inexact:
            half = np.hypot(half, self._hidden(fit.effects, best, normal.sum(axis=0), jacobians, bases))
        least = LEAST_WIDTH * sizes
        return np.minimum(x + best[:p] - half, x - least), np.maximum(x + best[:p] + half, x + least)

    def _hidden(self, effects: Set, best: Array, normal: Array, jacobians: list[Rows], bases: list[Moments]) -> Array:
        """How far each parameter [p] is off if what is left hides as much again of a law that resembles its effect.

        best: [p + q] where the last linearisation ends; normal: its matrix. Only what carries on from sample to sample
        counts, noise does not: of white noise products of neighbours sum to nought, give or take a root of the sum of
        their squares. Nuisances give way as far as their boxes reach.
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
        held += RIDGE * held.diagonal().max() * np.eye(len(held))
        return np.asarray(np.sqrt(left * np.linalg.inv(held).diagonal()[:p]))

    def _late(self) -> NDArray[np.bool_]:
        """Which blocks are in the second half of their trial, [B]."""
        last: dict[int, int] = {}
        for trial, number in self.blocks:
            last[trial] = max(last.get(trial, 0), number)
        return np.array([2 * number > last[trial] for trial, number in self.blocks])

    def _by_block(self, p: int, jacobians: list[Rows], bases: list[Moments]) -> tuple[Array, Array, Array]:
        """Normal matrices [B, p + q, p + q], slopes [B, p + q] and squares [B] of the blocks."""
        size, q = len(self.blocks), len(self.nuisance_low)
        normal, slope, squares = np.zeros((size, p + q, p + q)), np.zeros((size, p + q)), np.zeros(size)
        place = {name: i for i, name in enumerate(self.blocks)}
        for residual, jacobian, base in zip(self.whitened, jacobians, bases, strict=True):
            for (name, part), gg in zip(residual.blocks, residual.block_gg, strict=True):
                b, c, r = place[name], residual.columns[:, part], base.rows[part]
                normal[b, p:, p:] += gg
                slope[b, p:] += c @ r
                squares[b] += r @ r
                if len(jacobian):
                    j = jacobian[:, part]
                    across = j @ c.T
                    normal[b, :p, :p] += j @ j.T
                    normal[b, :p, p:] += across
                    normal[b, p:, :p] += across.T
                    slope[b, :p] += j @ r
        return normal, slope, squares


def _prior(effects: Set, x: Array) -> tuple[Array, Array]:
    """Normal matrix's diagonal [p] and slope [p] of the costs of changes."""
    parameters = [d for each in effects for d in each.parameters]
    held = np.array([PRIOR / d.size**2 for d in parameters])
    return held, held * (x - np.array([d.nominal for d in parameters]))


def _cost(effects: Set, x: Array) -> float:
    """Of the changes alone; see PRIOR."""
    held, pull = _prior(effects, x)
    return float(pull @ (pull / held))
