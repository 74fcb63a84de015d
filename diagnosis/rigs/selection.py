"""Which effects a stage of a rig has: all of them are fitted at once, then left out while the others can do without.

A rig's stage is cheap to simulate and has few candidates, so the search can begin at the rich end. One that adds an
effect at a time is stuck where two must come together (dry friction and drag in place of a viscous fit).
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from diagnosis.gap import box
from diagnosis.gap.candidates import Candidate
from diagnosis.gap.fits import BOUND_SHARE, Fit, Problem, Set, point_of
from diagnosis.gap.lens import Moments
from diagnosis.gap.search import Search
from diagnosis.gap.view import Array

LOSS_SHARE = 0.01  # an effect that takes less of the loss than this is not even tried further
POLISH = 6
STRIDES = (1.0, 0.4, 0.1)


@dataclass(frozen=True, slots=True)
class Refitted(Problem):
    """A problem of one view whose held-out losses are simulated: the laws of rigs have kinks, a line misleads there."""

    def _fit(self, effects: Set, x: Array, loss: float, jacobians: list[Array], bases: list[Moments]) -> Fit:
        # Named: zero-argument super() does not work in a dataclass with slots.
        fit = Problem._fit(self, effects, x, loss, jacobians, bases)
        normal, slope, _ = self._by_block(len(x), jacobians, bases)
        return replace(fit, held_out=self._held_out(effects, x, normal, slope))

    def _held_out(self, effects: Set, x: Array, normal: Array, slope: Array) -> Array:
        """By block: its squares after a refit without its fold, a Gauss-Newton step as far as it helps the others."""
        p, low, high = len(x), *self._box(effects, x)
        folds = np.unique(self.fold)
        states = [x]
        for fold in folds:
            kept = self.fold != fold
            step = box.solve(np.ascontiguousarray(normal[kept].sum(axis=0)), -slope[kept].sum(axis=0), low, high)[:p]
            states += [x + s * step for s in STRIDES] if p else []
        dials = [tuple(float(v) for v in state) for state in states]
        moments = self._moments([point_of(effects, _parts(effects, u)) for u in dials])[0]
        blocks = [self._blocks_of(each) for each in moments]
        held_out = np.empty(len(self.blocks))
        for k, fold in enumerate(folds):
            out = self.fold == fold
            mine = [0, *range(1 + k * len(STRIDES), 1 + (k + 1) * len(STRIDES))] if p else [0]
            found = [self._loss_of(effects, *blocks[i], ~out) for i in mine]
            best = min(range(len(mine)), key=lambda i: found[i][0])
            rr, gr, gg = blocks[mine[best]]
            w = found[best][1]
            held_out[out] = rr[out] + 2 * gr[out] @ w + np.einsum("i,bij,j->b", w, gg[out], w)
        return held_out

    def _blocks_of(self, moments: Moments) -> tuple[Array, Array, Array]:
        """Squares [B], products with the nuisances [B, q] and of these [B, q, q] of the one lens."""
        (lens,) = self.lenses
        q, place = len(self.nuisance_low), {name: i for i, name in enumerate(self.blocks)}
        rr, gr, gg = np.zeros(len(place)), np.zeros((len(place), q)), np.zeros((len(place), q, q))
        for name, part in lens.blocks:
            b, r, c = place[name], moments.rows[part].astype(float), lens.columns[:, part].astype(float)
            rr[b] += r @ r
            gr[b] += c @ r
            gg[b] += c @ c.T
        return rr, gr, gg

    def _loss_of(self, effects: Set, rr: Array, gr: Array, gg: Array, kept: Array) -> tuple[float, Array]:
        """Loss of some blocks, and the nuisances fitted to them."""
        normal, slope = gg[kept].sum(axis=0), gr[kept].sum(axis=0)
        w = box.solve(np.ascontiguousarray(normal), -slope, *self.nuisance_box(effects))
        return float(rr[kept].sum() + 2 * w @ slope + w @ normal @ w), w


class Backward(Search):
    """A search that begins with every effect that takes a share of the loss."""

    def full(self, nothing: Fit) -> Fit:
        """Add what lessens the loss most, until nothing does; settle the whole well. No folds here."""
        quick = Problem(*(getattr(self.problem, f.name) for f in fields(Problem)))
        ahead, fit = Search(quick, self.plain, self.stages, self.candidates), nothing
        for _ in self.candidates:
            best = min(ahead.extended(fit), key=lambda f: f.loss, default=fit)
            if not best.loss < fit.loss * (1 - LOSS_SHARE):
                break
            fit = best
        for _ in range(POLISH):
            best = quick.fit([(fit.effects, fit.u)])[0]
            if not best.loss < fit.loss * (1 - LOSS_SHARE / 2):
                break
            fit = best
        return self.problem.fit([(fit.effects, fit.u)])[0] if fit.effects else fit

    def chosen(self, full: Fit, nothing: Fit) -> Fit:
        """What is left when nothing more can be spared, and nothing stands at a bound."""
        fit = self.pruned(full)
        while fit.effects:
            pinned = [i for i, each in enumerate(fit.effects) if at_bound(each, fit.u[i])]
            lone = len(fit.effects) == 1 and not self.worth(self.gain(nothing, fit))
            if not pinned and not lone:
                return fit
            if len(fit.effects) == 1:
                return nothing
            fit = self.pruned(self.reduced(fit)[pinned[0]])
        return fit


def at_bound(effect: Candidate, u: Sequence[float]) -> bool:
    """Whether a dial stands at a physical bound that is neither its nominal nor its neutral value."""
    return any(
        min(x - d.low, d.high - x) < BOUND_SHARE * d.size
        and min(abs(x - d.nominal), abs(x - d.neutral)) > BOUND_SHARE * d.size
        for d, x in zip(effect.dials, u, strict=True)
    )


def _parts(effects: Set, x: Sequence[float]) -> tuple[tuple[float, ...], ...]:
    parts, at = [], 0
    for each in effects:
        parts.append(tuple(x[at : at + len(each.dials)]))
        at += len(each.dials)
    return tuple(parts)
