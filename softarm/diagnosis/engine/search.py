"""Search for the set of effects: forward, one more at a time, or backward from all effects at once.

Every comparison is between nested fits with the same nuisances, on held-out blocks.
"""

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from softarm.diagnosis.engine import equal_sets, resample, work
from softarm.diagnosis.engine.candidates import Candidate, Coordinates, EffectSet, parameters_of
from softarm.diagnosis.engine.equal_sets import Prediction
from softarm.diagnosis.engine.fits import COARSE, Fit, FitProblem
from softarm.diagnosis.engine.problem import BLOCK_LOSS
from softarm.diagnosis.engine.thresholds import ROBOT, Thresholds
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.engine.work import Progress, Work

EFFECTS_MAX = 3  # effects of a forward search
SIZES = (0.3, 1.0, 2.0)  # starts of a backward search, in usual changes
SHARE_MIN = 0.1  # share of a residual that is visible, however small its energy
SHARED_MIN = 0.1  # energy that two effects remove from a stage, at most, if they may replace each other there
CORRECTION = 0.02  # share of the gap's energy: a smaller gain within the ignored energy corrects another law
REFIT_MAX = 2  # effects of a set that is fitted from its own starts
PREDICTED = 8  # effects of a set from which some are removed by their sensitivities, before each is left out in turn
PURSUED, PURSUED_GAIN = 6, 0.05  # effects of a start that is far from nominal, and the least gain of each
POLISH, SETTLED = 4, 0.005  # further descents of a backward search, and the relative gain that ends them


@dataclass(frozen=True, slots=True)
class Gain:
    """Held-out gain of one fit over another."""

    value: float  # difference of losses
    low: float  # 95 % interval, block bootstrap
    high: float
    shares: Mapping[str, float]  # stage -> share of the residual's energy that is removed
    energies: Mapping[str, float]  # stage -> removed energy


@dataclass(frozen=True, slots=True)
class SelectedEffect:
    """Chosen effect with its gain next to the others and its rivals."""

    candidate: Candidate
    without: Fit  # the other selected effects alone
    gain: Gain
    rivals: tuple[tuple[Fit, Gain], ...]  # the set with a rival in its place, and the chosen set's gain over it
    equivalents: tuple[str, ...]  # effects that the data cannot separate from it
    bounded: tuple[str, ...] = ()  # rivals that would be equivalents, but are at the end of their range
    exchangeable: bool = False  # whether a set without it, as large as the chosen one, explains as much
    tolerated: bool = False  # whether its size is within the tolerance of a healthy system

    @property
    def strongest(self) -> str:
        """Return the stage from which the effect removes most energy."""
        return max(self.gain.energies, key=self.gain.energies.__getitem__)


@dataclass(frozen=True, slots=True)
class Choice:
    """Result of a search."""

    null_model: Fit  # nuisances alone
    alone: tuple[tuple[Fit, Gain], ...]  # every candidate alone, best first
    chosen: Fit
    selected: tuple[SelectedEffect, ...]  # largest gain first
    energies: tuple[Mapping[str, float], Mapping[str, float]]  # before, after
    equal_sets: tuple[Fit, ...] = ()  # other sets, as large as the chosen one, that explain as much


class Search:
    """Search over candidates on a problem; `plain` is the same problem in units of the noise floors."""

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
        self._rough = replace(problem, simulated=False)  # without simulated held-out losses
        self._first: Mapping[str, float] = {}  # energies of the whole gap
        self._extended: dict[frozenset[str], list[Fit]] = {}  # base names -> fits with one more effect
        self._reduced: dict[tuple[tuple[str, ...], Coordinates], list[Fit]] = {}
        self._fewer: list[Fit] = []  # fits without several effects at once
        self._settled: dict[str, tuple[float, ...]] = {}  # coordinates of the chosen effects
        self._work = Work(lambda text, share: None)

    def run(self, progress: Progress) -> Choice:
        """Return the chosen effects; the search is deterministic."""
        null_model = self.null_model()
        if max(self._first.values(), default=0.0) <= self.thresholds.gain.ignored:
            return Choice(null_model, (), null_model, (), (self._first, self._first))
        chosen = self.backward(null_model, progress) if self.thresholds.approximate else null_model
        if not chosen.effects:  # a backward search may end in a local minimum
            chosen = self.forward(null_model, progress)
        chosen = equal_sets.smallest(self, chosen, null_model)
        if self.thresholds.approximate:
            self._settled = dict(zip(chosen.names, chosen.u, strict=True))
        chosen, equals = equal_sets.first_of_equals(self, chosen, null_model)
        self.extended(chosen)  # further effects count in `fitted`
        energies = self.energies(null_model), self.energies(chosen)
        selected = self.selected(chosen, null_model, equals)
        return Choice(null_model, tuple(self.ranked(null_model)), chosen, selected, energies, equals)

    def null_model(self) -> Fit:
        """Fit the nuisances alone, without any effect."""
        fit = self.problem.fit([((), ())])[0]
        self._first = self.energies(fit)
        return fit

    def forward(self, null_model: Fit, progress: Progress) -> Fit:
        """Add one effect at a time, with swaps for rivals and pruning in between."""
        chosen, seen = null_model, {frozenset[str]()}
        while True:
            progress(f"searching effect {len(chosen.effects) + 1}", min(0.9, 0.3 * len(chosen.effects)))
            good: list[tuple[Fit, Gain]] = []
            others: list[tuple[Fit, Gain]] = []
            for fit, gain in self.ranked(chosen):
                (good if self.is_gain(gain) and self.is_nameable(fit, gain) else others).append((fit, gain))
            if not good or len(chosen.effects) == EFFECTS_MAX:
                return chosen
            if self.is_contested(*good[0], others):
                return chosen
            further = self.pruned(self.swapped(good[0][0]))
            if frozenset(further.names) in seen or not self.gain(chosen, further).value > 0:
                return chosen
            seen.add(frozenset(further.names))
            chosen = further

    def backward(self, null_model: Fit, progress: Progress) -> Fit:
        """Fit all effects at once and remove those that are unnecessary, at a bound or within tolerance."""
        self._work = Work(progress)
        for residual in self.problem.whitened:
            residual.gaps.on_rollouts = self._work.count
        pool = self.candidates
        fit = self.pruned(self.full(null_model, pool))
        for _ in range(self.thresholds.search.restarts):  # an effect at its bound replaced others: repeat without it
            bound = [c for c, u in zip(fit.effects, fit.u, strict=True) if c.at_bound(u)]
            if not bound or len(pool) == 1:
                break
            pool = tuple(c for c in pool if c is not bound[0])
            fit = self.pruned(self.full(null_model, pool))
        while fit.effects:
            pinned = [
                i
                for i, each in enumerate(fit.effects)
                if each.at_bound(fit.u[i]) or not each.exceeds_tolerance(fit.u[i])
            ]
            lone = len(fit.effects) == 1 and not self.is_gain(self.gain(null_model, fit))
            if not pinned and not lone:
                return fit
            if len(fit.effects) == 1:
                return null_model
            fit = self.pruned(self.reduced(fit)[pinned[0]])
        return fit

    def full(self, null_model: Fit, candidates: Sequence[Candidate]) -> Fit:
        """Fit all effects at once from several starts and return the best fit."""
        rounds = self.thresholds.search.rounds
        every = tuple(candidates)
        count, parameters = len(every), len(parameters_of(every))
        whole = work.full(parameters)
        self._work.begin("fitting all effects at once", whole, work.backward(count, parameters) - whole)
        started = [(every, tuple(_moved(c, size) for c in every)) for size in SIZES]
        if any(c.far for c in every):
            started.append((every, self._pursued(every)))
        fits = self._rough.fit(started, rounds)
        if self.thresholds.search.refit:
            fits += replace(self._rough, nudge=COARSE).fit(started, rounds)
        fit = min(fits, key=lambda f: f.loss)
        for _ in range(POLISH):
            best = self._rough.fit([(fit.effects, fit.u)], rounds)[0]
            settled = not best.loss < fit.loss * (1 - SETTLED)
            fit = min((fit, best), key=lambda f: f.loss)
            if settled:
                break
        return self.problem.fit([(fit.effects, fit.u)], rounds=1)[0] if fit.loss < null_model.loss else null_model

    def _pursued(self, every: EffectSet) -> Coordinates:
        """Return a start of all effects: near nominal, with one effect after another at its best own start.

        It reaches a minimum that is far from nominal, such as a servo with a twentieth of its gain.
        """
        u = tuple(_moved(c, SIZES[0]) for c in every)
        loss = np.inf
        for _ in range(PURSUED):
            sets = [(every, (*u[:i], start, *u[i + 1 :])) for i, c in enumerate(every) for start in (*c.starts, *c.far)]
            losses = self._rough.losses(sets)
            best = int(np.argmin(losses))
            if not losses[best] < loss * (1 - PURSUED_GAIN):
                break
            loss, u = losses[best], sets[best][1]
        return u

    def ranked(self, base: Fit) -> list[tuple[Fit, Gain]]:
        """Return a set with every further candidate and its gain, best first."""
        gains = [(fit, self.gain(base, fit)) for fit in self.extended(base)]
        return sorted(gains, key=lambda each: (-each[1].value, each[0].names))

    def is_correction(self, less: Fit, gain: Gain) -> bool:
        """Return whether a gain only corrects another effect's law: little of the gap, within the ignored energy."""
        left = max(self.energies(less).values(), default=0.0)
        little = all(e <= CORRECTION * self._first.get(s, 0.0) for s, e in gain.energies.items())
        ignored = self.thresholds.gain.ignored
        return ignored > 0 and left <= ignored and little

    def is_gain(self, gain: Gain) -> bool:
        """Return whether a gain is beyond chance and large enough to matter."""
        enough = gain.low > 0 and gain.value > self.thresholds.gain.loss_min
        return enough and any(self._is_visible(gain, stage) for stage in gain.shares)

    def is_nameable(self, fit: Fit, gain: Gain | None = None) -> bool:
        """Return whether a set's effects may be named: large enough, and none at a bound.

        The gain of the last effect must be resolved if the effect is within its tolerance.
        """
        last_exceeds = fit.effects[-1].exceeds_tolerance(fit.u[-1])
        resolved = gain is None or last_exceeds or gain.value > self.thresholds.gain.resolved_min
        return self.is_large(fit) and resolved and not fit.at_bound

    def is_contested(self, fit: Fit, gain: Gain, others: Sequence[tuple[Fit, Gain]]) -> bool:
        """Return whether what cannot be named explains the gap better than a set's last effect.

        Args:
            fit: set whose last effect may be named.
            gain: gain of that effect.
            others: sets with a last effect that cannot be named. A change of the model's own parameter within its
                tolerance counts in the same views. Against an effect within its tolerance all count but those like
                it, beyond chance.
        """
        if fit.effects[-1].exceeds_tolerance(fit.u[-1]):
            views, margin = self._views(fit.effects[-1]), 0.0
            own = [(f, g) for f, g in others if _is_within(f) and not f.effects[-1].is_missing]
            rivals = [(f, g) for f, g in own if views & self._views(f.effects[-1])]
        else:
            rivals = [(f, g) for f, g in others if not (_is_within(f) and f.effects[-1].is_missing)]
            margin = self.thresholds.gain.resolved_min
        return any(reached.value > gain.value - margin for _, reached in rivals)

    def is_large(self, fit: Fit) -> bool:
        """Return whether every effect exceeds its tolerance, or is missing in the model and alone in its views.

        Next to another effect, whose law is not exact, a change within tolerance may correct that law.
        """
        by_noise = np.isfinite(self.thresholds.gain.resolved_min)
        return all(
            each.exceeds_tolerance(u) or (by_noise and each.is_missing and self._is_alone(each, fit))
            for each, u in zip(fit.effects, fit.u, strict=True)
        )

    def _is_alone(self, effect: Candidate, fit: Fit) -> bool:
        """Return whether no other effect of a set acts on a view of this effect."""
        return all(each is effect or self._views(each).isdisjoint(self._views(effect)) for each in fit.effects)

    def _views(self, effect: Candidate) -> set[int]:
        """Return the indices of the views on which an effect acts."""
        paths = {d.path for d in effect.parameters}
        return {k for k, residual in enumerate(self.plain.whitened) if residual.gaps.view.acts & paths}

    def _is_visible(self, gain: Gain, stage: str) -> bool:
        t, share, energy = self.thresholds.gain, gain.shares[stage], gain.energies[stage]
        clearly = t.is_visible(share, energy, gain.low) or (gain.value > t.resolved_min and share > SHARE_MIN)
        return clearly and (share > t.further_share or energy > t.further_min * self._first.get(stage, 0.0))

    def extended(self, base: Fit, without: tuple[str, ...] = ()) -> list[Fit]:
        """Fit a set with every further candidate, from its best start; poor candidates only roughly."""
        memory, t = frozenset(base.names), self.thresholds.search
        if memory not in self._extended:
            options = [c for c in self.candidates if c.name not in base.names]
            started = self._started(base, options)
            # Without one chosen effect the others are distorted: also start rivals from the chosen coordinates.
            u = tuple(self._settled.get(c.name, own) for c, own in zip(base.effects, base.u, strict=True))
            started += self._started(replace(base, u=u), options) if u != base.u else []
            rough = _best_of_each(self._rough.fit(started, t.rounds_rough), lambda f: id(f.effects[-1]))
            least = base.loss - (1 - t.lag_share) * (base.loss - rough[0].loss) if rough else 0.0
            good = [f for f in rough[: t.candidates_max] if t.lag_share >= 1 or f.loss <= least]
            fine = self.problem.fit([(f.effects, f.u) for f in good], t.rounds) + rough[len(good) :]
            self._extended[memory] = _best_of_each(fine, lambda f: f.names[-1])  # the better form of an effect
        return [fit for fit in self._extended[memory] if fit.effects[-1].name not in without]

    def _started(self, base: Fit, options: Sequence[Candidate]) -> list[tuple[EffectSet, Coordinates]]:
        """Return the base with every option at its best start."""
        sets: list[tuple[EffectSet, Coordinates]] = [
            ((*base.effects, c), (*base.u, start)) for c in options for start in c.starts
        ]
        losses, at, started = self.problem.losses(sets), 0, []
        for c in options:
            started += [sets[i] for i in sorted(range(at, at + len(c.starts)), key=lambda i: losses[i])[:1]]
            at += len(c.starts)
        return started

    @property
    def fitted(self) -> list[Fit]:
        """Return every set that was fitted."""
        return [f for fits in (*self._extended.values(), *self._reduced.values(), self._fewer) for f in fits]

    def reduced(self, fit: Fit) -> list[Fit]:
        """Fit a set without each of its effects."""
        memory = (fit.names, fit.u)
        if memory not in self._reduced:
            every = range(len(fit.effects))
            sets = [fit.only([k for k in every if k != i]) for i in every]
            few = 1 < len(sets) <= REFIT_MAX + 1
            if self.thresholds.approximate and few:  # the other of two similar effects must grow to replace it
                prediction = Prediction(self.problem, fit)
                rests = combinations(range(len(sets)), len(sets) - 1)
                moved = [(each.effects, each.u) for each in map(prediction.of, rests)][::-1]
                better = np.less(self.problem.losses(moved), self.problem.losses(sets))
                sets = [m if gains else s for m, s, gains in zip(moved, sets, better, strict=True)]
            fits = self.problem.fit(sets, self.thresholds.search.rounds) if sets else []
            self._reduced[memory] = self._refitted(fits) if self.thresholds.search.refit and few else fits
        return self._reduced[memory]

    def _refitted(self, fits: Sequence[Fit]) -> list[Fit]:
        """Return each fit, or a better one from the best of its effects' own starts.

        A fit that descended together with other effects may have ended in another local minimum.
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
        again = self.problem.fit(begun, self.thresholds.search.rounds)
        return [min(pair, key=lambda f: f.loss) for pair in zip(fits, again, strict=True)]

    def pruned(self, fit: Fit) -> Fit:
        """Remove effects that the others do not need."""
        while len(fit.effects) > 1:
            self._begin_removal(fit)
            if self.thresholds.approximate and len(fit.effects) > PREDICTED and (fewer := self._without_weakest(fit)):
                fit = fewer
                continue
            gains = [(self.gain(less, fit), less) for less in self.reduced(fit)]
            weak = [(g.value, less) for g, less in gains if self._is_weak(less, g)]
            if not weak:
                return fit
            weak.sort(key=lambda each: each[0])
            fit = self._without_half(fit, [less for _, less in weak]) or weak[0][1]
        return fit

    def _without_weakest(self, fit: Fit) -> Fit | None:
        """Return a fit without the half of the effects that matters least by its sensitivities, if it is unnecessary.

        A quarter, and so on, is tried next; None if each of them is necessary.
        """
        prediction, kept, weakest = Prediction(self.problem, fit), [*range(len(fit.effects))], list[int]()
        for _ in range(len(kept) // 2):
            losses = [prediction.of([k for k in kept if k != i]).loss for i in kept]
            weakest.append(kept.pop(int(np.argmin(losses))))
        while weakest:
            rest = [i for i in range(len(fit.effects)) if i not in weakest]
            predicted = prediction.of(rest)
            starts = [fit.only(rest), (predicted.effects, predicted.u)]
            best = starts[int(np.argmin(self.problem.losses(starts)))]
            (less,) = self.problem.fit([best], self.thresholds.search.rounds)
            self._fewer.append(less)
            if self._is_weak(less, self.gain(less, fit)):
                return less
            weakest = weakest[: len(weakest) // 2]
        return None

    def _is_weak(self, less: Fit, gain: Gain) -> bool:
        """Return whether the effects that a fit lacks are unnecessary, by the gain with them."""
        return not self.is_gain(gain) or self.is_correction(less, gain)

    def _without_half(self, fit: Fit, rests: Sequence[Fit]) -> Fit | None:
        """Return a fit without half of the effects that are unnecessary one by one, if they are unnecessary together.

        A quarter, and so on, is tried next. rests: the fit without each of these effects, least gain first.
        """
        count = len(rests) // 2
        while count > 1:
            kept = [i for i, name in enumerate(fit.names) if all(name in less.names for less in rests[:count])]
            (less,) = self.problem.fit([fit.only(kept)], self.thresholds.search.rounds)
            if self._is_weak(less, self.gain(less, fit)):
                return less
            count //= 2
        return None

    def _begin_removal(self, fit: Fit) -> None:
        count, parameters = len(fit.effects), len(fit.x)
        own, before = work.reduced(count, parameters), work.full(parameters)
        self._work.begin(f"removing effects from {count}", own, work.backward(count, parameters) - before - own)

    def swapped(self, fit: Fit) -> Fit:
        """Replace single effects by rivals as long as the set improves."""
        for _ in range(EFFECTS_MAX):
            if len(fit.effects) < 2:
                return fit
            options = [
                each
                for less in self.reduced(fit)
                for each in self.extended(less, tuple(set(fit.names) - set(less.names)))
                if self.is_nameable(each)
            ]
            best = min(options, key=lambda f: float(f.held_out.sum()), default=fit)
            if not self.gain(fit, best).low > 0:
                return fit
            fit = best
        return fit

    def without_each(self, chosen: Fit, null_model: Fit) -> list[Fit]:
        """Return the chosen set without each of its effects; without its only effect it is the null model."""
        return self.reduced(chosen) if len(chosen.effects) > 1 else [null_model] * len(chosen.effects)

    def selected(self, chosen: Fit, null_model: Fit, equals: Sequence[Fit]) -> tuple[SelectedEffect, ...]:
        """Return each effect's gain next to the others, and its rivals; equals: sets that explain as much."""
        found = []
        for effect, u, less in zip(chosen.effects, chosen.u, self.without_each(chosen, null_model), strict=True):
            gain = self.gain(less, chosen)
            rivals = [(f, self.gain(f, chosen)) for f in self.extended(less, (effect.name,))]
            rivals.sort(key=lambda each: (each[1].value, each[0].names))
            alike = [f for f, g in rivals if self.is_equivalent(less, f, g, gain)]
            same = tuple(f.effects[-1].name for f in alike if not f.at_bound)
            bounded = tuple(f.effects[-1].name for f in alike if f.at_bound)
            doubtful = any(effect.name not in fit.names for fit in equals)
            small = not effect.exceeds_tolerance(u)
            found.append(SelectedEffect(effect, less, gain, tuple(rivals), same, bounded, doubtful, small))
        return tuple(sorted(found, key=lambda m: (-m.gain.value, m.candidate.name)))

    def is_equivalent(self, less: Fit, rival: Fit, lack: Gain, gain: Gain) -> bool:
        """Return whether a rival may be the cause as well: it explains the same part, and about as well.

        No law is exact. Far above the noise, a small lack is due to the form of the laws, however significant.
        """
        own, t = self.gain(less, rival), self.thresholds.rival
        least = min(SHARED_MIN, 0.5 * max(gain.energies.values()))
        shared = any(own.energies[s] > 0.5 * e and e >= least for s, e in gain.energies.items())
        rest = self.loss(rival) - lack.value
        close = lack.low <= 0 or lack.value < max(t.lack_max, t.lack_share * gain.value, t.misfit_share * rest)
        enough = self.is_large(rival) and self.is_gain(own)
        return enough and shared and close and lack.value < t.share_max * gain.value

    def gain(self, less: Fit, more: Fit) -> Gain:
        """Return the gain of `more` over `less`."""
        difference = self._counted(less) - self._counted(more)
        before, after = self.energies(less), self.energies(more)
        shares = {s: 1 - after[s] / before[s] for s in self.stages if before[s] > 1e-9}
        gone = {s: before[s] - after[s] for s in shares}
        low, high = resample.interval(resample.draws(len(difference)) @ difference)
        return Gain(float(difference.sum()), float(low), float(high), shares, gone)

    def loss(self, fit: Fit) -> float:
        """Return the held-out loss that gains are differences of."""
        return float(self._counted(fit).sum())

    def _counted(self, fit: Fit) -> Array:
        """Return the held-out losses by block, large ones tempered for approximate laws."""
        return tempered(fit) if self.thresholds.approximate else fit.held_out

    def energies(self, fit: Fit) -> dict[str, float]:
        """Return the energy of each stage's residual."""
        result = {}
        for stage, residual in zip(self.stages, self.plain.whitened, strict=True):
            rows = residual.moments([fit.point])[0].rows + residual.nuisance_rows(fit.nuisance)
            noise = float(np.mean((residual.gaps.view.noise / residual.gaps.view.floor) ** 2))
            result[stage] = max(float(rows @ rows) / max(residual.kept, 1.0) - noise, 0.0)
        return result


def tempered(fit: Fit) -> Array:
    """Return the held-out losses by block, with a logarithm beyond the usual loss of a block."""
    return np.asarray(BLOCK_LOSS * np.log1p(np.maximum(fit.held_out, 0.0) / BLOCK_LOSS))


def _is_within(fit: Fit) -> bool:
    return not fit.effects[-1].exceeds_tolerance(fit.u[-1])


def _best_of_each(fits: Sequence[Fit], key: Callable[[Fit], Hashable]) -> list[Fit]:
    """Return the best fit for each key, best first."""
    best: dict[Hashable, Fit] = {}
    for fit in sorted(fits, key=lambda f: f.loss):
        best.setdefault(key(fit), fit)
    return list(best.values())


def _moved(candidate: Candidate, size: float) -> tuple[float, ...]:
    """Return coordinates moved from nominal by a share of the usual change, within the bounds."""
    return tuple(min(max(d.nominal + size * d.size, d.low), d.high) for d in candidate.parameters)
