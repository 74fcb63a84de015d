"""Which effects: one more at a time by what each adds beside the others, or all at once and then who can be spared.

Every comparison is between nested fits that share their nuisances, on blocks that the fit in question has not seen.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from softarm.common import resample
from softarm.diagnosis.engine.candidates import Candidate, Set, U
from softarm.diagnosis.engine.fits import Fit, FitProblem
from softarm.diagnosis.engine.problem import BLOCK_LOSS
from softarm.diagnosis.engine.thresholds import ROBOT, Thresholds
from softarm.diagnosis.engine.view import Array

SIZES = (0.3, 1.0, 2.0)  # of usual changes: where all effects at once begin
RESTARTS = 3  # of that, each without one more that ended at its bound
EQUAL = 0.5  # of the loss held out: no difference at all
CORRECTION = 0.02  # of the gap's energy: beside what leaves no more than is quiet a smaller gain is no effect's
ANEW = 2  # effects of a set, at the most, that is fitted anew: among many a line goes astray
POLISH, SETTLED = 4, 0.005  # further descents of all effects at once, and what ends them: less gain, of the loss

Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True)
class Gain:
    """What one fit has over another, held out."""

    value: float  # difference of losses
    low: float  # 95 % interval, block bootstrap
    high: float
    shares: Mapping[str, float]  # stage -> share of the residual's energy that goes
    energies: Mapping[str, float]  # stage -> the same in units of the floor's energy


@dataclass(frozen=True, slots=True)
class SelectedEffect:
    """A chosen effect: what it adds beside the others, and who could stand in for it."""

    candidate: Candidate
    without: Fit  # the other selected effects alone
    gain: Gain
    rivals: tuple[tuple[Fit, Gain], ...]  # the whole set with a rival in its place, and what the chosen has over it
    equivalents: tuple[str, ...]
    bounded: tuple[str, ...] = ()  # who would be an equivalent, and stands at the end of its range


@dataclass(frozen=True, slots=True)
class Choice:
    """The outcome of a search."""

    null_model: Fit  # nuisances alone
    alone: tuple[tuple[Fit, Gain], ...]  # every candidate alone, the best first
    chosen: Fit
    selected: tuple[SelectedEffect, ...]  # in order of what each adds
    next_gain: Gain | None  # of the best that was not taken
    energies: tuple[Mapping[str, float], Mapping[str, float]]  # stage -> mean square over floor squared, before, after


class Search:
    """Candidates on a problem. `plain`: the same problem, its residuals weighed by the floors alone."""

    def __init__(
        self,
        problem: FitProblem,
        plain: FitProblem,
        stages: Sequence[str],
        candidates: Sequence[Candidate],
        thresholds: Thresholds = ROBOT,
    ) -> None:
        self.problem, self.plain, self.stages = problem, plain, tuple(stages)
        self.candidates, self.thresholds = tuple(candidates), thresholds
        self._rough = replace(problem, simulated=False)  # who has no promise is not simulated fold by fold
        self._first: Mapping[str, float] = {}  # the whole gap's energies
        self._extended: dict[frozenset[str], list[Fit]] = {}  # by the names of the base
        self._reduced: dict[tuple[tuple[str, ...], U], list[Fit]] = {}
        self._settled: dict[str, tuple[float, ...]] = {}  # the chosen effects' coordinates

    def run(self, tell: Progress) -> Choice:
        """Search. Deterministic."""
        null_model = self.null_model()
        if max(self._first.values(), default=0.0) <= self.thresholds.quiet:
            return Choice(null_model, (), null_model, (), None, (self._first, self._first))
        chosen = self.backward(null_model, tell) if self.thresholds.backward else null_model
        if not chosen.effects:  # all at once may end in a well of their own, where one alone does not
            chosen = self.forward(null_model, tell)
        if self.thresholds.backward:
            self._settled = dict(zip(chosen.names, chosen.u, strict=True))
            chosen = self.first_of_equals(chosen, null_model)
        further = next((g for f, g in self.ranked(chosen) if not f.at_bound), None)
        energies = self.energies(null_model), self.energies(chosen)
        return Choice(
            null_model, tuple(self.ranked(null_model)), chosen, self.selected(chosen, null_model), further, energies
        )

    def null_model(self) -> Fit:
        """Nuisances alone."""
        fit = self.problem.fit([((), ())])[0]
        self._first = self.energies(fit)
        return fit

    def forward(self, null_model: Fit, tell: Progress) -> Fit:
        """One effect more at a time, swapped for rivals and pruned in between."""
        chosen, seen, most = null_model, {frozenset[str]()}, self.thresholds.effects_max
        while True:
            tell(f"which effect: {len(chosen.effects) + 1}", min(0.9, 0.3 * len(chosen.effects)))
            ranked = self.ranked(chosen)
            good = [(f, g) for f, g in ranked if self.worth(g) and f.is_news and not f.at_bound]
            if not good or len(chosen.effects) == most:
                return chosen
            further = self.pruned(self.swapped(good[0][0]))
            if frozenset(further.names) in seen or not self.gain(chosen, further).value > 0:
                return chosen
            seen.add(frozenset(further.names))
            chosen = further

    def backward(self, null_model: Fit, tell: Progress) -> Fit:
        """All effects at once; what is left when nothing more can be spared, stands at a bound or is no news."""
        tell("all effects at once", 0.0)
        pool = self.candidates
        fit = self.pruned(self.full(null_model, pool))
        for _ in range(RESTARTS):  # what ends at its bound took the place of others: again, without it
            bound = [c for c, u in zip(fit.effects, fit.u, strict=True) if c.at_bound(u)]
            if not bound or len(pool) == 1:
                break
            pool = tuple(c for c in pool if c is not bound[0])
            fit = self.pruned(self.full(null_model, pool))
        while fit.effects:
            tell(f"which of {len(fit.effects)} can be spared", 0.5)
            pinned = [i for i, each in enumerate(fit.effects) if each.at_bound(fit.u[i]) or not each.is_news(fit.u[i])]
            lone = len(fit.effects) == 1 and not self.worth(self.gain(null_model, fit))
            if not pinned and not lone:
                return fit
            if len(fit.effects) == 1:
                return null_model
            fit = self.pruned(self.reduced(fit)[pinned[0]])
        return fit

    def full(self, null_model: Fit, candidates: Sequence[Candidate]) -> Fit:
        """All effects at once, from starts of several sizes; of the wells the deepest. No folds here."""
        rounds = self.thresholds.rounds
        every = tuple(candidates)
        started = [(every, tuple(_moved(c, size) for c in every)) for size in SIZES]
        fit = min(self._rough.fit(started, rounds), key=lambda f: f.loss)
        for _ in range(POLISH):
            best = self._rough.fit([(fit.effects, fit.u)], rounds)[0]
            settled = not best.loss < fit.loss * (1 - SETTLED)
            fit = min((fit, best), key=lambda f: f.loss)
            if settled:
                break
        return self.problem.fit([(fit.effects, fit.u)], rounds=1)[0] if fit.loss < null_model.loss else null_model

    def ranked(self, base: Fit) -> list[tuple[Fit, Gain]]:
        """A set with every further candidate and what that adds, the best first."""
        gains = [(fit, self.gain(base, fit)) for fit in self.extended(base)]
        return sorted(gains, key=lambda each: (-each[1].value, each[0].names))

    def is_correction(self, less: Fit, gain: Gain) -> bool:
        """Whether a gain takes away what nobody is blamed for, and next to nothing of the gap: of another's law."""
        left = max(self.energies(less).values(), default=0.0)
        little = all(e <= CORRECTION * self._first.get(s, 0.0) for s, e in gain.energies.items())
        return self.thresholds.quiet > 0 and left <= self.thresholds.quiet and little

    def worth(self, gain: Gain) -> bool:
        """Whether a gain is one: beyond chance, and large enough to matter."""
        enough = gain.low > 0 and gain.value > self.thresholds.gain_min
        return enough and any(self._shows(gain, stage) for stage in gain.shares)

    def _shows(self, gain: Gain, stage: str) -> bool:
        t, share, energy = self.thresholds, gain.shares[stage], gain.energies[stage]
        clearly = any(share > s and energy > e and gain.low > low for s, e, low in t.shown)
        return clearly and (share > t.further_share or energy > t.further_min * self._first.get(stage, 0.0))

    def extended(self, base: Fit, without: tuple[str, ...] = ()) -> list[Fit]:
        """A set with every further candidate, each from the best of its starts; those without promise only roughly."""
        memory, t = frozenset(base.names), self.thresholds
        if memory not in self._extended:
            options = [c for c in self.candidates if c.name not in base.names]
            started = self._started(base, options)
            # Without one of the chosen the others stand askew; a rival fits better beside what they were with it.
            u = tuple(self._settled.get(c.name, own) for c, own in zip(base.effects, base.u, strict=True))
            started += self._started(replace(base, u=u), options) if u != base.u else []
            rough = _best_of_each(self._rough.fit(started, t.rounds_rough))
            least = base.loss - (1 - t.hopeless) * (base.loss - rough[0].loss) if rough else 0.0
            good = [f for f in rough[: t.promising] if t.hopeless >= 1 or f.loss <= least]
            fine = self.problem.fit([(f.effects, f.u) for f in good], t.rounds) + rough[len(good) :]
            forms: dict[str, Fit] = {}
            for fit in sorted(fine, key=lambda f: f.loss):  # of the forms of one effect the better one
                forms.setdefault(fit.effects[-1].name, fit)
            self._extended[memory] = list(forms.values())
        return [fit for fit in self._extended[memory] if fit.effects[-1].name not in without]

    def _started(self, base: Fit, options: Sequence[Candidate]) -> list[tuple[Set, U]]:
        """Every option at its best starts beside the base."""
        sets: list[tuple[Set, U]] = [((*base.effects, c), (*base.u, start)) for c in options for start in c.starts]
        losses, at, started = self.problem.losses(sets), 0, []
        for c in options:
            mine = sorted(range(at, at + len(c.starts)), key=lambda i: losses[i])[: self.thresholds.starts_kept]
            started += [sets[i] for i in mine]
            at += len(c.starts)
        return started

    @property
    def tried(self) -> list[Fit]:
        """Every set that was fitted to the end."""
        return [f for fits in (*self._extended.values(), *self._reduced.values()) for f in fits]

    def reduced(self, fit: Fit) -> list[Fit]:
        """A set without each of its effects."""
        memory = (fit.names, fit.u)
        if memory not in self._reduced:
            sets = [_without(fit, i) for i in range(len(fit.effects))]
            few = 1 < len(sets) <= ANEW + 1
            if self.thresholds.backward and few:  # of two that do the same, half of one is far from the whole
                moved = self.problem.left_out(fit)
                better = np.less(self.problem.losses(moved), self.problem.losses(sets))
                sets = [m if gains else s for m, s, gains in zip(moved, sets, better, strict=True)]
            fits = self.problem.fit(sets, self.thresholds.rounds) if sets else []
            self._reduced[memory] = self._anew(fits) if self.thresholds.anew and few else fits
        return self._reduced[memory]

    def _anew(self, fits: Sequence[Fit]) -> list[Fit]:
        """Each set, or what it comes to from the best of its effects' own starts if that is better.

        Who had many others beside it on the way down may have ended in a well that is not its own.
        """
        begun = []
        for fit in fits:
            sets = [
                (fit.effects, (*fit.u[:i], start, *fit.u[i + 1 :]))
                for i, effect in enumerate(fit.effects)
                for start in effect.starts
            ]
            losses = self.problem.losses(sets)
            begun.append(sets[int(np.argmin(losses))])
        again = self.problem.fit(begun, self.thresholds.rounds)
        return [min(pair, key=lambda f: f.loss) for pair in zip(fits, again, strict=True)]

    def pruned(self, fit: Fit) -> Fit:
        """Leave out what the others can do without."""
        while len(fit.effects) > 1:
            spared = [(self.gain(less, fit), less) for less in self.reduced(fit)]
            weak = [(g.value, less) for g, less in spared if not self.worth(g) or self.is_correction(less, g)]
            if not weak:
                return fit
            fit = min(weak, key=lambda each: each[0])[1]
        return fit

    def swapped(self, fit: Fit) -> Fit:
        """Change single effects for rivals as long as the whole gains by it."""
        for _ in range(self.thresholds.effects_max):
            if len(fit.effects) < 2:
                return fit
            options = [
                each
                for less in self.reduced(fit)
                for each in self.extended(less, tuple(set(fit.names) - set(less.names)))
                if each.is_news and not each.at_bound
            ]
            best = min(options, key=lambda f: float(f.held_out.sum()), default=fit)
            if not self.gain(fit, best).low > 0:
                return fit
            fit = best
        return fit

    def spared(self, chosen: Fit, null_model: Fit) -> list[Fit]:
        """The chosen without each of its effects; without the only one it is the null model."""
        return self.reduced(chosen) if len(chosen.effects) > 1 else [null_model] * len(chosen.effects)

    def selected(self, chosen: Fit, null_model: Fit) -> tuple[SelectedEffect, ...]:
        """What each effect adds beside the others, and its rivals there."""
        found = []
        for effect, less in zip(chosen.effects, self.spared(chosen, null_model), strict=True):
            gain = self.gain(less, chosen)
            rivals = [(f, self.gain(f, chosen)) for f in self.extended(less, (effect.name,))]
            rivals.sort(key=lambda each: (each[1].value, each[0].names))
            alike = [f for f, g in rivals if self.alike(less, f, g, gain)]
            same = tuple(f.effects[-1].name for f in alike if not f.at_bound)
            bounded = tuple(f.effects[-1].name for f in alike if f.at_bound)
            found.append(SelectedEffect(effect, less, gain, tuple(rivals), same, bounded))
        return tuple(sorted(found, key=lambda m: (-m.gain.value, m.candidate.name)))

    def first_of_equals(self, chosen: Fit, null_model: Fit) -> Fit:
        """Of two that the data cannot tell apart at all the list's first leads: whoever came first in the search."""
        order = [c.name for c in self.candidates]
        for effect, less in zip(chosen.effects, self.spared(chosen, null_model), strict=True):
            for rival in sorted(self.extended(less, chosen.names), key=lambda f: order.index(f.effects[-1].name)):
                earlier = order.index(rival.effects[-1].name) < order.index(effect.name)
                same = abs(self.gain(rival, chosen).value) < EQUAL
                if earlier and same and rival.is_news and not rival.at_bound:
                    return rival
        return chosen

    def alike(self, less: Fit, rival: Fit, lack: Gain, gain: Gain) -> bool:
        """Whether a rival may be the cause as well: it explains the same part, and as well but for chance.

        No law is exact. Where that shows far above the noise, a small lack tells of the laws' forms, not of the cause,
        however sure it is.
        """
        own, t = self.gain(less, rival), self.thresholds
        shared = any(own.energies[s] > 0.5 * e > 0.05 for s, e in gain.energies.items())
        rest = float(self._counted(rival).sum()) - lack.value
        close = lack.low <= 0 or lack.value < max(t.tie, t.misfit_share * rest)
        return rival.is_news and self.worth(own) and shared and close and lack.value < t.rival_share * gain.value

    def gain(self, less: Fit, more: Fit) -> Gain:
        """What `more` has over `less`."""
        difference = self._counted(less) - self._counted(more)
        before, after = self.energies(less), self.energies(more)
        shares = {s: 1 - after[s] / before[s] for s in self.stages if before[s] > 1e-9}
        gone = {s: before[s] - after[s] for s in shares}
        return Gain(float(difference.sum()), *bootstrap(difference), shares, gone)

    def _counted(self, fit: Fit) -> Array:
        """Held-out losses by block as they count."""
        return tempered(fit) if self.thresholds.tempered else fit.held_out

    def energies(self, fit: Fit) -> dict[str, float]:
        """Stage -> mean square of the residual in units of the floor."""
        result = {}
        for stage, residual in zip(self.stages, self.plain.whitened, strict=True):
            rows = residual.moments([fit.point])[0].rows + fit.nuisance.astype(np.float32) @ residual.columns
            noise = float(np.mean((residual.gaps.view.noise / residual.gaps.view.floor) ** 2))
            result[stage] = max(float(rows @ rows) / max(residual.kept, 1.0) - noise, 0.0)
        return result


def bootstrap(difference: Array) -> tuple[float, float]:
    """95 % interval of a sum over blocks, the blocks drawn anew; the draws are always the same."""
    low, high = resample.interval(resample.draws(len(difference)) @ difference)
    return float(low), float(high)


def tempered(fit: Fit) -> Array:
    """Held-out losses by block, those beyond a block's worth by their logarithm."""
    return np.asarray(BLOCK_LOSS * np.log1p(np.maximum(fit.held_out, 0.0) / BLOCK_LOSS))


def _without(fit: Fit, i: int) -> tuple[Set, U]:
    return fit.effects[:i] + fit.effects[i + 1 :], fit.u[:i] + fit.u[i + 1 :]


def _best_of_each(fits: Sequence[Fit]) -> list[Fit]:
    """Of the fits with the same last candidate the best; all of them sorted, the best first."""
    best: dict[int, Fit] = {}
    for fit in sorted(fits, key=lambda f: f.loss):
        best.setdefault(id(fit.effects[-1]), fit)
    return list(best.values())


def _moved(candidate: Candidate, size: float) -> tuple[float, ...]:
    """Every parameter away from its nominal by a share of its usual change, as far as the bounds allow."""
    return tuple(min(max(d.nominal + size * d.size, d.low), d.high) for d in candidate.parameters)
