"""Examination of a set of views: search, flexible model, structure of the residual, decision."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

from softarm.diagnosis.engine.candidates import Candidate
from softarm.diagnosis.engine.ceiling import beyond_chance, explainable, hum
from softarm.diagnosis.engine.decision import Decision, Evidence, decide
from softarm.diagnosis.engine.fits import Fit
from softarm.diagnosis.engine.fitted import FittedChoice, Widening, search_problem
from softarm.diagnosis.engine.problem import Setup, interleaved
from softarm.diagnosis.engine.search import Search
from softarm.diagnosis.engine.slow import slow_changes
from softarm.diagnosis.engine.structure import Structure, structure
from softarm.diagnosis.engine.thresholds import Thresholds
from softarm.diagnosis.engine.view import Point
from softarm.diagnosis.engine.whitened import BLOCK_S
from softarm.diagnosis.engine.work import Progress

FLEXIBLE_MIN = 0.6  # energy above which a flexible model is worth its time; up to 1 it changes no decision


class Examination(FittedChoice):
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
        plain, stages, known = setup.plain(), [view.stage for view in setup.views], tuple(candidates)

        def part(low: float, high: float) -> Progress:
            return lambda what, share: progress(what, low + share * (high - low))

        search = Search(search_problem(setup, t), plain, stages, known, t)
        if not t.approximate:  # the residual of a first search is the noise model of the second
            rough = search.run(part(0.0, 0.5))
            residuals = setup.residuals(plain, rough.chosen)
            search = Search(search_problem(setup, t, residuals), plain, stages, known, t)
        choice = search.run(progress if t.approximate else part(0.5, 1.0))
        super().__init__(setup, search, choice, widened, original or {})
        self.searched: Fit = choice.chosen  # with the held-out data of its rivals

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

    @cached_property
    def bent(self) -> dict[str, float]:
        """Return the linearisation errors of the nuisances, for stages that keep much of their gap."""
        most, (_, after), fit = self.thresholds.cause.rest_most, self.choice.energies, self.choice.chosen
        rest = {view.stage: max(after[view.stage] - 1, self.structures[view.stage].energy) for view in self.setup.views}
        return {stage: self.setup.linearisation_error(stage, fit) for stage, energy in rest.items() if energy > most}

    @cached_property
    def slow(self) -> dict[str, Structure]:
        """Return the strongest slow change of a fitted strength, by the stage that shows it."""
        return slow_changes(self.setup, self.search, self.searched)

    def decide(
        self,
        signs: Mapping[str, Structure] | None = None,
        unresolved: frozenset[str] | None = None,
        caused: bool = False,
    ) -> Decision:
        """Return the verdict on the chosen effects.

        Args:
            signs: stage -> finding of a further test, which no effect of the list explains. A slow change comes first.
            unresolved: chosen effects that the data do not resolve; by default those of the search's own data.
            caused: whether the views hold a named effect already.
        """
        unresolved = self.unresolved if unresolved is None else unresolved
        signs = {**(signs or {}), **self.slow}
        shares = {stage: share for stage, (share, _) in self.flexible.items()}
        evidence = Evidence(shares, self.structures, self.tolerated, self.bent, signs, unresolved, caused)
        decision = decide(self.choice, evidence, self.thresholds)
        if decision.kind == "unknown" and self.thresholds.approximate and not signs:  # the floor is an estimate
            return decide(self.choice, replace(evidence, proven=self.proven), self.thresholds)
        return decision
