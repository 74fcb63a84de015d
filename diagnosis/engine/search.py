"""Which effects: forward by what each adds beside the others, back by what each can be spared, swapped for rivals.

Every comparison is between nested fits that share their nuisances, on blocks that the fit in question has not seen.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from softarm.common import resample
from softarm.diagnosis.engine.candidates import Candidate
from softarm.diagnosis.engine.fits import Fit, FitProblem, Set, U
from softarm.diagnosis.engine.view import Array

EFFECTS_MAX = 3
STARTS_KEPT = 1
PROMISING = 10  # candidates that are fitted to the end
GAIN_MIN = 8.0  # what an effect must add, held out: weighted squares, about four per second and view
# And in one view that it acts on: share of the residual's energy, energy in units of the floor's, and the lower end of
# the gain. What moves a residual within the floor is news only if it is a part of it and beyond all doubt.
SHOWN = ((0.10, 0.30, 0.0), (0.20, 0.10, 0.0), (0.10, 0.05, 10.0))
# And beside another effect: of the energy that the whole gap had there, or most of what the other leaves. A
# correction to another effect's law is no effect.
FURTHER_MIN, FURTHER_SHARE = 0.06, 0.4
TIE = 10.0  # what a rival lacks, held out: no more than this is no difference
RIVAL_SHARE = 0.12  # a rival that lacks no more than this share of the gain may be the cause as well
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
        self, problem: FitProblem, plain: FitProblem, stages: Sequence[str], candidates: Sequence[Candidate]
    ) -> None:
        self.problem, self.plain, self.stages = problem, plain, tuple(stages)
        self.candidates = tuple(candidates)
        self._first: Mapping[str, float] = {}  # the whole gap's energies
        self._extended: dict[frozenset[str], list[Fit]] = {}  # by the names of the base

    def run(self, tell: Progress, effects_max: int = EFFECTS_MAX) -> Choice:
        """Search. Deterministic."""
        null_model = self.problem.fit([((), ())])[0]
        chosen, seen = null_model, {frozenset[str]()}
        self._first = self.energies(null_model)
        while True:
            tell(f"which effect: {len(chosen.effects) + 1}", min(0.9, 0.3 * len(chosen.effects)))
            ranked = self.ranked(chosen)
            good = [(f, g) for f, g in ranked if self.worth(g) and f.is_news and not f.at_bound]
            if not good or len(chosen.effects) == effects_max:
                break
            further = self.pruned(self.swapped(good[0][0]))
            if frozenset(further.names) in seen or not self.gain(chosen, further).value > 0:
                break
            seen.add(frozenset(further.names))
            chosen = further
        following = next((g for f, g in ranked if not f.at_bound), None)
        energies = self.energies(null_model), self.energies(chosen)
        selected = self.selected(chosen, null_model)
        return Choice(null_model, tuple(self.ranked(null_model)), chosen, selected, following, energies)

    def ranked(self, base: Fit) -> list[tuple[Fit, Gain]]:
        """A set with every further candidate and what that adds, the best first."""
        gains = [(fit, self.gain(base, fit)) for fit in self.extended(base)]
        return sorted(gains, key=lambda each: (-each[1].value, each[0].names))

    def worth(self, gain: Gain) -> bool:
        """Whether a gain is one: beyond chance, and large enough to matter."""
        return gain.low > 0 and gain.value > GAIN_MIN and any(self._shows(gain, stage) for stage in gain.shares)

    def _shows(self, gain: Gain, stage: str) -> bool:
        share, energy = gain.shares[stage], gain.energies[stage]
        clearly = any(share > s and energy > e and gain.low > low for s, e, low in SHOWN)
        return clearly and (share > FURTHER_SHARE or energy > FURTHER_MIN * self._first.get(stage, 0.0))

    def extended(self, base: Fit, without: tuple[str, ...] = ()) -> list[Fit]:
        """A set with every further candidate, each from the best of its starts; those without promise only roughly."""
        memory = frozenset(base.names)
        if memory not in self._extended:
            options = [c for c in self.candidates if c.name not in base.names]
            rough = sorted(self.problem.fit(self._started(base, options), rounds=2), key=lambda f: f.loss)
            fine = self.problem.fit([(f.effects, f.u) for f in rough[:PROMISING]]) + rough[PROMISING:]
            forms: dict[str, Fit] = {}
            for fit in sorted(fine, key=lambda f: f.loss):  # of the forms of one effect the better one
                forms.setdefault(fit.effects[-1].name, fit)
            self._extended[memory] = list(forms.values())
        return [fit for fit in self._extended[memory] if fit.effects[-1].name not in without]

    def _started(self, base: Fit, options: Sequence[Candidate]) -> list[tuple[Set, U]]:
        """Every option at its best start beside the base."""
        sets: list[tuple[Set, U]] = [((*base.effects, c), (*base.u, start)) for c in options for start in c.starts]
        losses, at, started = self.problem.losses(sets), 0, []
        for c in options:
            mine = sorted(range(at, at + len(c.starts)), key=lambda i: losses[i])[:STARTS_KEPT]
            started += [sets[i] for i in mine]
            at += len(c.starts)
        return started

    def reduced(self, fit: Fit) -> list[Fit]:
        """A set without each of its effects."""
        sets = [_without(fit, i) for i in range(len(fit.effects))]
        return self.problem.fit(sets) if sets else []

    def pruned(self, fit: Fit) -> Fit:
        """Leave out what the others can do without."""
        while len(fit.effects) > 1:
            spared = [(self.gain(less, fit), less) for less in self.reduced(fit)]
            weak = [(g.value, less) for g, less in spared if not self.worth(g)]
            if not weak:
                return fit
            fit = min(weak, key=lambda each: each[0])[1]
        return fit

    def swapped(self, fit: Fit) -> Fit:
        """Change single effects for rivals as long as the whole gains by it."""
        for _ in range(EFFECTS_MAX):
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

    def selected(self, chosen: Fit, null_model: Fit) -> tuple[SelectedEffect, ...]:
        """What each effect adds beside the others, and its rivals there."""
        found = []
        for i, less in enumerate(
            self.reduced(chosen) if len(chosen.effects) > 1 else [null_model] * len(chosen.effects)
        ):
            name, gain = chosen.effects[i].name, self.gain(less, chosen)
            rivals = [(f, self.gain(f, chosen)) for f in self.extended(less, (name,))]
            rivals.sort(key=lambda each: (each[1].value, each[0].names))
            same = tuple(f.effects[-1].name for f, g in rivals if self.alike(less, f, g, gain))
            found.append(SelectedEffect(chosen.effects[i], less, gain, tuple(rivals), same))
        return tuple(sorted(found, key=lambda m: (-m.gain.value, m.candidate.name)))

    def alike(self, less: Fit, rival: Fit, lack: Gain, gain: Gain) -> bool:
        """Whether a rival may be the cause as well: it explains the same part, and as well but for chance."""
        own = self.gain(less, rival)
        shared = any(own.energies[s] > 0.5 * e > 0.05 for s, e in gain.energies.items())
        close = lack.value < RIVAL_SHARE * gain.value and (lack.low <= 0 or lack.value < TIE)
        return rival.is_news and not rival.at_bound and self.worth(own) and shared and close

    def gain(self, less: Fit, more: Fit) -> Gain:
        """What `more` has over `less`."""
        difference = less.held_out - more.held_out
        before, after = self.energies(less), self.energies(more)
        shares = {s: 1 - after[s] / before[s] for s in self.stages if before[s] > 1e-9}
        gone = {s: before[s] - after[s] for s in shares}
        return Gain(float(difference.sum()), *bootstrap(difference), shares, gone)

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


def _without(fit: Fit, i: int) -> tuple[Set, U]:
    return fit.effects[:i] + fit.effects[i + 1 :], fit.u[:i] + fit.u[i + 1 :]
