"""Chosen effects with their fits on the data of one setup: sizes, intervals, residuals, and sets without an effect."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from softarm.diagnosis.engine.candidates import Candidate, Coordinates, FittedParameter, parameters_of, point_of
from softarm.diagnosis.engine.decision import Decision
from softarm.diagnosis.engine.fits import EDGE_COST, Fit, FitProblem
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.search import Choice, Search
from softarm.diagnosis.engine.thresholds import Thresholds
from softarm.diagnosis.engine.view import Array, Point

REACHED = 0.01  # change of a sample, in noise floors, from which it shows an effect

Widening = Callable[[Fit, Array, Array], tuple[Array, Array]]


def search_problem(setup: Setup, t: Thresholds, residuals: Sequence[NDArray[np.floating]] | None = None) -> FitProblem:
    """Return the problem of a search, whitened by these residuals (by view, [M, S]) or scaled by the nominal gap."""
    return replace(setup.weighed(residuals), simulated=t.approximate, fold=setup.search_folds(t.search.folds))


class FittedChoice:
    """Choice of a search, fitted to the data of a setup."""

    def __init__(self, setup: Setup, search: Search, choice: Choice, widened: Widening, original: Point) -> None:
        """Prepare the figures of a choice.

        Args:
            setup: problem of the views.
            search: search on this problem.
            choice: effects that were chosen, with their fits on this problem.
            widened: adds the uncertainty of the laws to the interval of a fit's parameters, low and high, [p] each.
            original: parameters of the nominal model that the views have replaced.
        """
        self.setup, self.search, self.plain = setup, search, search.plain
        self.stages, self.thresholds = search.stages, search.thresholds
        self._widened, self._original = widened, original
        self._intervals: dict[tuple[tuple[str, ...], Coordinates], tuple[Array, Array]] = {}
        self.choice: Choice = replace(choice, chosen=self.held_out([choice.chosen])[0])

    def on(self, setup: Setup) -> "FittedChoice":
        """Return the same choice with its effects fitted to the data of another setup of these stages."""
        t = self.thresholds
        search = Search(search_problem(setup, t), setup.plain(), self.stages, self.search.candidates, t)
        null_model, chosen = self.choice.null_model, self.choice.chosen
        both = search.problem.fit([(fit.effects, fit.u) for fit in (null_model, chosen)], t.search.rounds)
        choice = replace(self.choice, null_model=both[0], chosen=both[1])
        return FittedChoice(setup, search, choice, self._widened, self._original)

    @property
    def verdict_problem(self) -> FitProblem:
        """Return the search's problem with the held-out data of the verdict (kinds, else trials)."""
        return replace(self.search.problem, fold=self.setup.fold)

    def held_out(self, fits: Sequence[Fit]) -> list[Fit]:
        """Return fits with the held-out data of the verdict."""
        if self.thresholds.search.folds == "held_out":
            return list(fits)
        return self.verdict_problem.fit([(f.effects, f.u) for f in fits], rounds=1)

    @cached_property
    def residuals(self) -> dict[str, NDArray[np.float32]]:
        """Return the residuals with the chosen effects by stage, [M, S]."""
        return dict(zip(self.stages, self.setup.residuals(self.plain, self.choice.chosen), strict=True))

    @property
    def nominal(self) -> Fit:
        """Return the nominal model, without any effect or nuisance, as a fit."""
        null_model, values = self.choice.null_model, np.array([*self._original.values()])
        fixed = [FittedParameter(path, "", x, x, x, 1.0, x) for path, x in self._original.items()]
        folds = max(len(null_model.folds), len(np.unique(self.plain.fold)))  # of the search, of the verdict
        return replace(
            null_model,
            effects=(Candidate("original", self.stages[0], tuple(fixed), ()),) if fixed else (),
            u=(tuple(values),) if fixed else (),
            nuisance=0 * null_model.nuisance,
            folds=np.tile(values, (folds, 1)),
            apart=np.tile(values, (folds + 2, 1)),
        )

    def interval(self, fit: Fit) -> tuple[Array, Array]:
        """Return the 95 % interval of a fit's parameters, low and high, [p] each."""
        key = fit.names, fit.u
        if key not in self._intervals:
            found = self.search.problem.interval(fit, self.thresholds.approximate)
            self._intervals[key] = self._widened(fit, *found)
        return self._intervals[key]

    @cached_property
    def unresolved(self) -> frozenset[str]:
        """Return the chosen effects that the data do not resolve.

        The interval of such an effect contains the model's own value, or no sample reaches the effect. The others'
        intervals change without it, so the one with the smallest gain is left out until all others are resolved. The
        last one is resolved if it is beside all others: without them, it has their gap as well.
        """
        gains = {effect.candidate.name: effect.gain.value for effect in self.choice.selected}
        fit, found = self.choice.chosen, set[str]()
        beside_all = open_ones = self.open_effects(fit)
        while open_ones and len(fit.effects) > 1:
            found.add(min(open_ones, key=lambda name: gains.get(name, 0.0)))
            fit = self.verdict_problem.part(fit, [i for i, name in enumerate(fit.names) if name not in found])
            open_ones = self.open_effects(fit)
        return frozenset(found | {*open_ones} & {*beside_all})

    def open_effects(self, fit: Fit) -> list[str]:
        """Return the effects of a fit that may have the model's own value, or that no sample reaches.

        Each parameter's interval contains the own value, and so does the region of all parameters together: gain and
        offset of a reading may be uncertain while both together are not.
        """
        found, first = [], 0
        if not fit.effects:
            return []
        low, high = self.interval(fit)
        _, best, spread = self.search.problem.region(fit, self.thresholds.approximate)
        nominal = np.array([d.nominal for d in parameters_of(fit.effects)])
        for i, effect in enumerate(fit.effects):
            own = [j for j, d in enumerate(effect.parameters, first) if not d.shape]
            first += len(effect.parameters)
            apart = any(not low[j] <= nominal[j] <= high[j] for j in own)
            apart = apart or (len(own) > 1 and _excludes((best - nominal)[own], spread[np.ix_(own, own)]))
            if not apart or not self._is_reached(fit, i):
                found.append(effect.name)
        return found

    def _is_reached(self, fit: Fit, i: int) -> bool:
        """Return whether any sample's prediction changes if an effect of a fit goes back to the model's own value."""
        nominal = tuple(d.nominal for d in fit.effects[i].parameters)
        without = point_of(fit.effects, (*fit.u[:i], nominal, *fit.u[i + 1 :]))
        for gaps in self.setup.gaps:
            both = gaps.fetch([fit.point, without])
            change = both[gaps.key(without)] - both[gaps.key(fit.point)]
            if np.abs(np.nan_to_num(change) / gaps.view.floor).max() > REACHED:
                return True
        return False

    def named(self, decision: Decision) -> Fit:
        """Return the fit of the named effects alone: the model of figures, calibration and patch.

        If one of them then has the model's own value or is at a bound, all keep the sizes that they have beside the
        dropped effects. Of the sizes that fit alike next to other nuisances, those that need least of them are taken.
        """
        chosen, names = self.choice.chosen, {effect.candidate.name for effect in decision.selected}
        kept = [i for i, name in enumerate(chosen.names) if name in names]
        if not kept:
            return self.choice.null_model
        problem = replace(self.verdict_problem, edge_cost=EDGE_COST)
        alone = problem.fit([chosen.only(kept)], self.thresholds.search.rounds)[0]
        return self.verdict_problem.part(chosen, kept) if self.open_effects(alone) or alone.at_bound else alone

    def without_each(self, fit: Fit) -> dict[str, Fit]:
        """Return a fit without each of its effects, by the name of the missing one."""
        less = self.search.without_each(fit, self.choice.null_model)
        return dict(zip(fit.names, self.held_out(less), strict=True))

    @cached_property
    def null_residuals(self) -> dict[str, NDArray[np.float32]]:
        """Return the residuals with the nuisances alone by stage, [M, S]."""
        return dict(zip(self.stages, self.setup.residuals(self.plain, self.choice.null_model), strict=True))


def _excludes(change: Array, spread: Array) -> bool:
    """Return whether the joint 95 % region of some parameters excludes no change.

    Args:
        change: changes of the parameters, [k].
        spread: their covariance, scaled so that the root of its diagonal is half a 95 % interval, [k, k].
    """
    if not np.isfinite(spread).all():
        return False
    wider = float(chdtri(len(change), 0.05) / chdtri(1, 0.05))
    return float(change @ np.linalg.lstsq(spread, change, rcond=None)[0]) > wider
