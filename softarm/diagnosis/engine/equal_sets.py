"""Sets of effects that explain the recordings as well as the chosen set: smaller sets, and sets of the same size.

A search that adds, removes or replaces single effects cannot find that one mass acts as a gain and a damping together.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from softarm.diagnosis.engine import box
from softarm.diagnosis.engine.candidates import Candidate, Coordinates, EffectSet, joined, parameters_of, split
from softarm.diagnosis.engine.fits import Fit, FitProblem

if TYPE_CHECKING:
    from softarm.diagnosis.engine.search import Search

FITTED_MAX = 6  # sets of one size that are fitted, the best by prediction
COMPARED_MAX = 10  # effects of a chosen set that is compared with others; the number of sets doubles with each effect
EQUAL = 0.5  # held-out loss that counts as no difference


def smallest(search: "Search", chosen: Fit, null_model: Fit) -> Fit:
    """Return the simplest of the smallest sets to which the chosen one adds no gain, or the chosen set."""
    for size in range(1, len(chosen.effects)):
        alike = [
            fit for fit in _fitted(search, chosen, null_model, size) if not search.is_gain(search.gain(fit, chosen))
        ]
        if alike:
            return _simplest(search, alike)
    return chosen


def first_of_equals(search: "Search", chosen: Fit, null_model: Fit) -> tuple[Fit, tuple[Fit, ...]]:
    """Return the simplest set as large as the chosen one that explains as much, whichever of them was chosen.

    Sets that differ from it in two effects or more and explain as much come second, best first.
    """
    if not chosen.effects:
        return chosen, ()
    others = _fitted(search, chosen, null_model, len(chosen.effects))
    less = search.without_each(chosen, null_model)
    exchanged = [fit for each in less for fit in search.extended(each, chosen.names) if search.is_nameable(fit)]
    first = _simplest(search, [chosen, *others, *exchanged])
    if first is not chosen:
        others = _fitted(search, first, null_model, len(first.effects))
    whole = search.gain(null_model, first)
    lacks = [(search.gain(fit, first), fit) for fit in others if len(first.effects) > 1]
    equals = [(lack.value, fit) for lack, fit in lacks if search.is_equivalent(null_model, fit, lack, whole)]
    return first, tuple(fit for _, fit in sorted(equals, key=lambda each: each[0]))


def _simplest(search: "Search", fits: Sequence[Fit]) -> Fit:
    """Return the fit with the fewest parameters among those that explain as much within noise as the best.

    Of several, the best is returned; of those without a difference, the one whose effects come first.
    """
    order = [each.name for each in search.candidates]
    best = min(fits, key=search.loss)
    lacks = [search.gain(fit, best) for fit in fits]
    alike = [f for f, g in zip(fits, lacks, strict=True) if g.low <= 0 and g.value <= search.thresholds.gain.loss_min]
    simple = [fit for fit in alike if len(fit.x) == min(len(each.x) for each in alike)]
    least = min(map(search.loss, simple))
    same = [fit for fit in simple if search.loss(fit) < least + EQUAL]
    return min(same, key=lambda fit: (sorted(map(order.index, fit.names)), search.loss(fit)))


def _fitted(search: "Search", chosen: Fit, null_model: Fit, size: int) -> list[Fit]:
    """Return fits of the most promising sets of a size, without those at a bound or within tolerance."""
    alone = search.extended(null_model)
    fits: Sequence[Fit] = alone
    if size > 1 and len(chosen.effects) > COMPARED_MAX:
        return []
    if size > 1:
        options = [fit.effects[0] for fit in alone if fit.names[0] not in chosen.names]
        prediction = Prediction(search.problem, chosen, options)
        # The search has compared the subsets of the chosen set, and sets with one other effect.
        shared_max = size - 2 if size == len(chosen.effects) else size - 1
        best = prediction.best(size, shared_max)
        fits = search.problem.fit([(each.effects, each.u) for each in best], search.thresholds.search.rounds)
    return [fit for fit in fits if search.is_nameable(fit)]


@dataclass(frozen=True, slots=True)
class PredictedSet:
    """Set of effects with the coordinates and the loss that the sensitivities predict."""

    effects: EffectSet
    u: Coordinates
    loss: float  # difference from the loss of the fit


class Prediction:
    """Linear model of a fit with further effects at their nominal values."""

    def __init__(self, problem: FitProblem, fit: Fit, options: Sequence[Candidate] = ()) -> None:
        """Simulate the sensitivities at a fit; options: further effects that a set may hold."""
        self._problem, self.effects, self._fitted = problem, (*fit.effects, *options), len(fit.effects)
        u = (*fit.u, *(tuple(d.nominal for d in each.parameters) for each in options))
        self._normal, self._slope = problem.sensitivities(replace(fit, effects=self.effects, u=u))
        self._x = joined(u)
        self._owner = np.repeat(np.arange(len(self.effects)), [len(each.parameters) for each in self.effects])

    def best(self, size: int, shared_max: int) -> list[PredictedSet]:
        """Return the most promising sets of a size, FITTED_MAX at most, best first.

        Sets that share the same effects of the fit lose at least as much as these with every option, so most sets need
        no prediction (branch and bound, Furnival and Wilson 1974).

        Args:
            size: number of effects.
            shared_max: effects of the fit in a set, at most.
        """
        own, options = range(self._fitted), range(self._fitted, len(self.effects))
        least = max(size - len(options), 0)
        shared = [each for count in range(least, shared_max + 1) for each in combinations(own, count)]
        bounds = [self.of((*each, *options)).loss for each in shared]
        found: list[PredictedSet] = []
        for i in np.argsort(bounds, kind="stable"):
            if len(found) == FITTED_MAX and bounds[i] >= found[-1].loss:
                break
            found += [self.of((*shared[i], *more)) for more in combinations(options, size - len(shared[i]))]
            found = sorted(found, key=lambda each: each.loss)[:FITTED_MAX]
        return found

    def of(self, members: Collection[int]) -> PredictedSet:
        """Return the best fit of some of `effects`, by index, next to the nuisances; the others become nominal."""
        effects = tuple(self.effects[i] for i in sorted(members))
        parameters = parameters_of(self.effects)
        inside = np.isin(self._owner, list(members))
        kept = np.flatnonzero(inside)
        free, gone = np.append(kept, np.arange(len(self._x), len(self._slope))), np.flatnonzero(~inside)
        change = np.zeros(len(self._slope))
        change[gone] = [parameters[i].nominal - self._x[i] for i in gone]
        slope = self._slope[free] + self._normal[np.ix_(free, gone)] @ change[gone]
        # Up to the physical bounds, since the change is large.
        limits = [
            np.append([getattr(parameters[i], end) - self._x[i] for i in kept], nuisances)
            for end, nuisances in zip(("low", "high"), self._problem.nuisance_box(effects), strict=True)
        ]
        change[free] = box.solve(np.ascontiguousarray(self._normal[np.ix_(free, free)]), -slope, *limits)
        loss = float(2 * self._slope @ change + change @ self._normal @ change)
        return PredictedSet(effects, split(effects, self._x[kept] + change[kept]), loss)
