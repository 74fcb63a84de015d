"""Examination of a set of views: search, flexible model, structure of the residual, decision."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from softarm.diagnosis.engine.candidates import Candidate, Coordinates, FittedParameter, parameters_of, point_of
from softarm.diagnosis.engine.ceiling import beyond_chance, explainable, hum
from softarm.diagnosis.engine.decision import Decision, Evidence, decide
from softarm.diagnosis.engine.fits import EDGE_COST, Fit, FitProblem
from softarm.diagnosis.engine.problem import Setup, interleaved
from softarm.diagnosis.engine.search import Choice, Search
from softarm.diagnosis.engine.slow import slow_changes
from softarm.diagnosis.engine.structure import Structure, structure
from softarm.diagnosis.engine.thresholds import Thresholds
from softarm.diagnosis.engine.view import Array, Point
from softarm.diagnosis.engine.whitened import BLOCK_S
from softarm.diagnosis.engine.work import Progress

REACHED = 0.01  # change of a sample, in noise floors, from which it shows an effect
FLEXIBLE_MIN = 0.6  # energy above which a flexible model is worth its time; up to 1 it changes no decision

Widening = Callable[[Fit, Array, Array], tuple[Array, Array]]


class Examination:
    """Steps of a diagnosis on one problem; each step runs once, when its result is needed."""

    def __init__(
        self,
        setup: Setup,
        candidates: Sequence[Candidate],
        t: Thresholds,
        progress: Progress,
        widened: Widening = lambda fit, low, high: (low, high),
        original: Point | None = None,
    ) -> None:
        """Search for the effects.

        Args:
            setup: problem of the views.
            candidates: effects that may be the cause.
            t: thresholds of the system.
            progress: called with the current step and the finished share, 0 to 1.
            widened: adds the uncertainty of the laws to the interval of a fit's parameters, low and high, [p] each.
            original: parameters of the nominal model that the views have replaced, by default none.
        """
        self.setup, self.thresholds, self._widened, self._original = setup, t, widened, original or {}
        self._intervals: dict[tuple[tuple[str, ...], Coordinates], tuple[Array, Array]] = {}
        self.stages = tuple(view.stage for view in setup.views)
        self.plain = setup.plain()
        known = tuple(candidates)

        def search(problem: FitProblem) -> Search:
            problem = replace(problem, simulated=t.approximate, fold=setup.search_folds(t.search.folds))
            return Search(problem, self.plain, self.stages, known, t)

        def part(low: float, high: float) -> Progress:
            return lambda what, share: progress(what, low + share * (high - low))

        self.search = search(setup.weighed())
        if not t.approximate:  # the residual of a first search is the noise model of the second
            rough = self.search.run(part(0.0, 0.5))
            self.search = search(setup.weighed(setup.residuals(self.plain, rough.chosen)))
        choice = self.search.run(progress if t.approximate else part(0.5, 1.0))
        self.searched: Fit = choice.chosen  # with the held-out data of its rivals
        self.choice: Choice = replace(choice, chosen=self.held_out([choice.chosen])[0])

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

    @cached_property
    def flexible(self) -> dict[str, tuple[float, Mapping[str, float]]]:
        """Return the explainable share of each stage's residual, and the features that a flexible model uses."""
        found: dict[str, tuple[float, Mapping[str, float]]] = {}
        for view in self.setup.views:
            if self.choice.energies[1][view.stage] > FLEXIBLE_MIN:
                own = self.setup.by_sample(view, self.setup.fold)
                share, uses = explainable(view, self.residuals[view.stage], own, self.setup.block_s / BLOCK_S)
                found[view.stage] = max(share, self._by_law(view.stage)), uses
        return found

    @cached_property
    def proven(self) -> dict[str, float]:
        """Return the share of each stage's residual that a hum or, beyond chance, a flexible model explains."""
        folds, pace = interleaved(self.setup.blocks), self.setup.block_s / BLOCK_S
        return {
            view.stage: hum(view, self.residuals[view.stage])
            or beyond_chance(view, self.residuals[view.stage], self.setup.by_sample(view, folds), pace)
            for view in self.setup.views
        }

    def _by_law(self, stage: str) -> float:
        """Return the largest share of a stage's residual that another fitted set removes."""
        after = self.choice.energies[1][stage]
        fits = self.search.fitted
        least = min((self.search.energies(f)[stage] for f in fits), default=after)
        return max(0.0, 1 - least / after) if after > 0 else 0.0

    @cached_property
    def structures(self) -> dict[str, Structure]:
        """Return the structure of each stage's residual."""
        return {
            view.stage: structure(view, self.residuals[view.stage], self.setup.kinds, self.setup.block_s)
            for view in self.setup.views
        }

    @cached_property
    def tolerated(self) -> dict[str, float]:
        """Return the energy of each stage that nuisances and replaced parameters explain without any effect."""
        raw = self.search.energies(self.nominal)
        return {s: max(raw[s] - e, 0.0) for s, e in self.choice.energies[0].items()}

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
            halves=np.tile(values, (2, 1)),
        )

    @cached_property
    def bent(self) -> dict[str, float]:
        """Return the linearisation errors of the nuisances, for stages that keep much of their gap."""
        most, (_, after), fit = self.thresholds.cause.rest_most, self.choice.energies, self.choice.chosen
        rest = {view.stage: max(after[view.stage] - 1, self.structures[view.stage].energy) for view in self.setup.views}
        return {stage: self.setup.linearisation_error(stage, fit) for stage, energy in rest.items() if energy > most}

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
        intervals change without it, so the one with the smallest gain is left out until all others are resolved.
        """
        gains = {effect.candidate.name: effect.gain.value for effect in self.choice.selected}
        fit, found = self.choice.chosen, set[str]()
        while len(fit.effects) > 1 and (open_ones := self._open(fit)):
            found.add(min(open_ones, key=lambda name: gains.get(name, 0.0)))
            fit = self.verdict_problem.part(fit, [i for i, name in enumerate(fit.names) if name not in found])
        return frozenset(found)

    def _open(self, fit: Fit) -> list[str]:
        """Return the effects of a fit that may have the model's own value, or that no sample reaches.

        Each parameter's interval contains the own value, and so does the region of all parameters together: gain and
        offset of a reading may be uncertain while both together are not.
        """
        found, first = [], 0
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

    @cached_property
    def slow(self) -> dict[str, Structure]:
        """Return the strongest slow change of a fitted strength, by the stage that shows it."""
        return slow_changes(self.setup, self.search, self.searched)

    def decide(self, signs: Mapping[str, Structure] | None = None) -> Decision:
        """Return the verdict on the chosen effects.

        Args:
            signs: stage -> finding of a further test, which no effect of the list explains. A slow change comes first.
        """
        signs = {**(signs or {}), **self.slow}
        shares = {stage: share for stage, (share, _) in self.flexible.items()}
        evidence = Evidence(shares, self.structures, self.tolerated, self.bent, signs, self.unresolved)
        decision = decide(self.choice, evidence, self.thresholds)
        if decision.kind == "unknown" and self.thresholds.approximate and not signs:  # the floor is an estimate
            return decide(self.choice, replace(evidence, proven=self.proven), self.thresholds)
        return decision

    def named(self, decision: Decision) -> Fit:
        """Return the fit of the named effects alone: the model of figures, calibration and patch.

        If one of them then has the model's own value or is at a bound, all keep the sizes that they have beside the
        dropped effects. Of the sizes that fit alike next to other nuisances, a rig's are those that need least of them.
        """
        chosen, names = self.choice.chosen, {effect.candidate.name for effect in decision.selected}
        kept = [i for i, name in enumerate(chosen.names) if name in names]
        if not kept:
            return self.choice.null_model
        problem = self.verdict_problem
        if self.thresholds.approximate:
            problem = replace(problem, edge_cost=EDGE_COST)
        elif len(kept) == len(chosen.effects):
            return chosen
        alone = problem.fit([chosen.only(kept)], self.thresholds.search.rounds)[0]
        return self.verdict_problem.part(chosen, kept) if self._open(alone) or alone.at_bound else alone

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
