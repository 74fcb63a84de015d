"""Which effects a stage of a rig has: all of them are fitted at once, then left out while the others can do without.

A rig's stage is cheap to simulate and has few candidates, so the search can begin at the rich end. One that adds an
effect at a time is stuck where two must come together (dry friction and drag in place of a viscous fit).
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine import box
from softarm.diagnosis.engine.candidates import Candidate
from softarm.diagnosis.engine.fits import Fit, FitProblem, Set, U, point_of, split
from softarm.diagnosis.engine.problem import PER_SECOND
from softarm.diagnosis.engine.search import GAIN_MIN, RIVAL_SHARE, TIE, Gain, Search, bootstrap
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.engine.whitened import BLOCK_S, Moments, Rows

SHARE_MIN, FLOORS_MIN = 0.10, 0.30  # of the energy that is left without an effect, and in units of the floor's
MISFIT_SHARE = 0.25  # of the loss that the best leaves: what a rival may lack and still be the cause
SIZES = (0.3, 1.0, 2.0)  # of usual changes: where all effects at once begin
BLOCK_LOSS = PER_SECOND * BLOCK_S  # of a block whose residual is as large as what it is weighed by
ROUNDS, POLISH = 12, 4
SETTLED = 0.005  # of the loss: who gains less is in the well
STRIDES = (1.0, 0.3)


@dataclass(frozen=True, slots=True)
class Refitted(FitProblem):
    """A problem of one view whose held-out losses are simulated: the laws of rigs have kinks, a line misleads there."""

    def _fit(self, effects: Set, x: Array, loss: float, jacobians: list[Rows], bases: list[Moments]) -> Fit:
        # Named: zero-argument super() does not work in a dataclass with slots.
        fit = FitProblem._fit(self, effects, x, loss, jacobians, bases)
        return replace(fit, held_out=self._held_out(effects, x, fit.folds))

    def _held_out(self, effects: Set, x: Array, refits: Array) -> Array:
        """By block: its squares after a refit without its fold, a Gauss-Newton step as far as it helps the others.

        refits: [F, p] where that step would end.
        """
        folds, strides = np.unique(self.fold), STRIDES if len(x) else ()
        states = [x, *(x + s * (refit - x) for refit in refits for s in strides)]
        points = [point_of(effects, split(effects, state)) for state in states]
        edges, order, gg = self._blocks()
        blocks = [self._sums(moments, edges, order) for moments in self._moments(points)[0]]
        held_out = np.empty(len(self.blocks))
        for k, fold in enumerate(folds):
            out = self.fold == fold
            mine = [0, *range(1 + k * len(strides), 1 + (k + 1) * len(strides))]
            found = [self._loss_of(effects, blocks[i], gg, ~out) for i in mine]
            best = min(range(len(mine)), key=lambda i: found[i][0])
            rr, gr = blocks[mine[best]]
            w = found[best][1]
            held_out[out] = rr[out] + 2 * gr[out] @ w + np.einsum("i,bij,j->b", w, gg[out], w)
        return held_out

    def _blocks(self) -> tuple[list[int], list[int], Array]:
        """Of the one view: first row and place of every block, and the nuisances' products there [B, q, q]."""
        (residual,) = self.whitened
        place = {name: i for i, name in enumerate(self.blocks)}
        edges = [part.start for _, part in residual.blocks]  # they follow one another without gaps
        order = [place[name] for name, _ in residual.blocks]
        gg = np.zeros((len(place), *residual.gg.shape))
        gg[order] = residual.block_gg
        return edges, order, gg

    def _sums(self, moments: Moments, edges: list[int], order: list[int]) -> tuple[Array, Array]:
        """Squares [B] of a point's rows, and their products with the nuisances [B, q]."""
        r, c = moments.rows.astype(float), self.whitened[0].columns
        rr, gr = np.zeros(len(self.blocks)), np.zeros((len(self.blocks), len(c)))
        rr[order] = np.add.reduceat(r * r, edges)
        gr[order] = np.add.reduceat(c * r, edges, axis=1).T
        return rr, gr

    def _loss_of(
        self, effects: Set, sums: tuple[Array, Array], gg: Array, kept: NDArray[np.bool_]
    ) -> tuple[float, Array]:
        """Loss of some blocks, and the nuisances fitted to them."""
        rr, gr = sums
        normal, slope = gg[kept].sum(axis=0), gr[kept].sum(axis=0)
        w = box.solve(np.ascontiguousarray(normal), -slope, *self.nuisance_box(effects))
        return float(rr[kept].sum() + 2 * w @ slope + w @ normal @ w), w


class Backward(Search):
    """A search that begins with every effect that takes a share of the loss."""

    def __init__(
        self, problem: FitProblem, plain: FitProblem, stages: Sequence[str], candidates: Sequence[Candidate]
    ) -> None:
        """See Search."""
        super().__init__(problem, plain, stages, candidates)
        self._reduced: dict[tuple[tuple[str, ...], U], list[Fit]] = {}
        self._settled: dict[str, tuple[float, ...]] = {}  # the chosen effects' parameters

    def gain(self, less: Fit, more: Fit) -> Gain:
        """See Search; but blocks that hold more than their share count by the logarithm of it.

        At the fast end of a sweep a hair's breadth in a limit makes or breaks all of a block, whatever else is fitted.
        """
        difference = tempered(less) - tempered(more)
        before, after = self.energies(less), self.energies(more)
        shares = {s: 1 - after[s] / before[s] for s in self.stages if before[s] > 1e-9}
        gone = {s: before[s] - after[s] for s in shares}
        return Gain(float(difference.sum()), *bootstrap(difference), shares, gone)

    def worth(self, gain: Gain) -> bool:
        """Whether a gain is one: beyond chance, a share of what is left, and above the floor.

        No share of the whole gap is asked for, unlike of the robot: a dead time of one sample is real beside a lag
        and an end of the torque that make the gap twenty times as large.
        """
        shown = any(gain.shares[s] > SHARE_MIN and gain.energies[s] > FLOORS_MIN for s in gain.shares)
        return gain.low > 0 and gain.value > GAIN_MIN and shown

    def alike(self, less: Fit, rival: Fit, lack: Gain, gain: Gain) -> bool:
        """Whether a rival may be the cause as well: it lacks little of the gain, and little of what nothing explains.

        No law here is exact. Where that shows far above the noise, a small lack tells of the laws' forms, not of the
        cause, however sure it is.
        """
        rest = float(tempered(rival).sum()) - lack.value
        close = lack.low <= 0 or lack.value < max(TIE, MISFIT_SHARE * rest)
        enough = close and lack.value < RIVAL_SHARE * gain.value
        return enough and not rival.at_bound and self.worth(self.gain(less, rival))

    def extended(self, base: Fit, without: tuple[str, ...] = ()) -> list[Fit]:
        """A set with every further candidate, each from the best of its starts; all to the end, there are few."""
        memory = frozenset(base.names)
        if memory not in self._extended:
            options = [c for c in self.candidates if c.name not in base.names]
            started = self._started(base, options)
            # Without one of the chosen the others stand askew; a rival fits better beside what they were with it.
            u = tuple(self._settled.get(c.name, own) for c, own in zip(base.effects, base.u, strict=True))
            started += self._started(replace(base, u=u), options) if u != base.u else []
            fits = sorted(self.problem.fit(started, ROUNDS), key=lambda f: f.loss)
            best = {fit.effects[-1].name: fit for fit in reversed(fits)}
            self._extended[memory] = list(best.values())
        return [fit for fit in self._extended[memory] if fit.effects[-1].name not in without]

    def reduced(self, fit: Fit) -> list[Fit]:
        """A set without each of its effects."""
        memory = (fit.names, fit.u)
        if memory not in self._reduced:
            parts = range(len(fit.effects))
            sets = [(fit.effects[:i] + fit.effects[i + 1 :], fit.u[:i] + fit.u[i + 1 :]) for i in parts]
            self._reduced[memory] = self.problem.fit(sets, ROUNDS) if sets else []
        return self._reduced[memory]

    def full(self, null_model: Fit) -> Fit:
        """All effects at once, from starts of several sizes; of the wells the deepest. No folds here."""
        quick = FitProblem(*(getattr(self.problem, f.name) for f in fields(FitProblem)))
        started = [(self.candidates, tuple(_moved(c, size) for c in self.candidates)) for size in SIZES]
        fit = min(quick.fit(started, rounds=ROUNDS), key=lambda f: f.loss)
        for _ in range(POLISH):
            best = quick.fit([(fit.effects, fit.u)], rounds=ROUNDS)[0]
            settled = not best.loss < fit.loss * (1 - SETTLED)
            fit = min((fit, best), key=lambda f: f.loss)
            if settled:
                break
        return self.problem.fit([(fit.effects, fit.u)], rounds=1)[0] if fit.loss < null_model.loss else null_model

    def chosen(self, full: Fit, null_model: Fit) -> Fit:
        """What is left when nothing more can be spared, stands at a bound or is no news."""
        fit = self.pruned(full)
        while fit.effects:
            pinned = [i for i, each in enumerate(fit.effects) if each.at_bound(fit.u[i]) or not each.is_news(fit.u[i])]
            lone = len(fit.effects) == 1 and not self.worth(self.gain(null_model, fit))
            if not pinned and not lone:
                self._settled = dict(zip(fit.names, fit.u, strict=True))
                return fit
            if len(fit.effects) == 1:
                return null_model
            fit = self.pruned(self.reduced(fit)[pinned[0]])
        return fit


def tempered(fit: Fit) -> Array:
    """Held-out losses by block, those beyond a block's worth by their logarithm."""
    return np.asarray(BLOCK_LOSS * np.log1p(np.maximum(fit.held_out, 0.0) / BLOCK_LOSS))


def _moved(candidate: Candidate, size: float) -> tuple[float, ...]:
    """Every parameter away from its nominal by a share of its usual change, as far as the bounds allow."""
    return tuple(min(max(d.nominal + size * d.size, d.low), d.high) for d in candidate.parameters)
