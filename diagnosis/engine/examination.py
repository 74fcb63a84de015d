"""One set of views examined from end to end: searched, held against any model, looked at for structure, decided."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.candidates import Candidate
from softarm.diagnosis.engine.ceiling import explainable
from softarm.diagnosis.engine.decision import Decision, decide
from softarm.diagnosis.engine.fits import Fit, FitProblem
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.search import Choice, Progress, Search
from softarm.diagnosis.engine.structure import Structure, structure
from softarm.diagnosis.engine.thresholds import Thresholds
from softarm.diagnosis.engine.whitened import BLOCK_S, blocks_of


class Examination:
    """What a setup's views show, one step after the other; each is done once."""

    def __init__(
        self, setup: Setup, candidates: Sequence[Candidate], kinds: Sequence[str], t: Thresholds, tell: Progress
    ) -> None:
        """kinds: of every trial of the views, its excitation. tell: what is searched, and how far (0 to 1)."""
        self.setup, self.thresholds, self._kinds = setup, t, tuple(kinds)
        self.stages = tuple(view.stage for view in setup.views)
        self.plain = setup.plain()
        known = tuple(candidates)

        def search(problem: FitProblem) -> Search:
            problem = replace(problem, simulated=t.simulated, fold=setup.searched(t.searched))
            return Search(problem, self.plain, self.stages, known, t)

        def part(low: float, high: float) -> Progress:
            return lambda what, share: tell(what, low + share * (high - low))

        self.search = search(setup.weighed())
        if t.whitened:  # twice: the first time to learn what the rest looks like, the second with it as the noise
            rough = self.search.run(part(0.0, 0.5))
            self.search = search(setup.weighed(setup.residuals(self.plain, rough.chosen)))
        choice = self.search.run(part(0.5, 1.0) if t.whitened else tell)
        self.searched: Fit = choice.chosen  # held out as its rivals are
        self.choice: Choice = replace(choice, chosen=self.judged([choice.chosen])[0])

    def judged(self, fits: Sequence[Fit]) -> list[Fit]:
        """Fits held out by what no fit saw (kinds, else trials), wherever the search was held out by less."""
        if self.thresholds.searched == "unseen":
            return list(fits)
        problem = replace(self.search.problem, fold=self.setup.fold)
        return problem.fit([(f.effects, f.u) for f in fits], rounds=1)

    @cached_property
    def left(self) -> dict[str, NDArray[np.float32]]:
        """Stage -> what the chosen effects leave, [M, S]."""
        return dict(zip(self.stages, self.setup.residuals(self.plain, self.choice.chosen), strict=True))

    @cached_property
    def flexible(self) -> dict[str, tuple[float, Mapping[str, float]]]:
        """Stage -> share of the rest that a flexible model finds, and what it looks at; no law found does better."""
        found: dict[str, tuple[float, Mapping[str, float]]] = {}
        fold = dict(zip(self.setup.blocks, self.setup.fold, strict=True))
        for view in self.setup.views:
            if self.choice.energies[1][view.stage] > self.thresholds.looked_at:
                own = np.empty(len(view.trial), dtype=np.int64)
                for name, a, b in blocks_of(view, self.setup.block_s):
                    own[a:b] = fold[name]
                share, uses = explainable(view, self.left[view.stage], own, self.setup.block_s / BLOCK_S)
                found[view.stage] = max(share, self._by_law(view.stage)), uses
        return found

    def _by_law(self, stage: str) -> float:
        """Share of the rest that the best law tried beside the chosen ones takes away."""
        after = self.choice.energies[1][stage]
        fits = self.search.tried
        least = min((self.search.energies(f)[stage] for f in fits), default=after)
        return max(0.0, 1 - least / after) if after > 0 else 0.0

    @cached_property
    def structures(self) -> dict[str, Structure]:
        """Stage -> what the rest has that noise has not."""
        return {
            view.stage: structure(view, self.left[view.stage], self._kinds, self.setup.block_s)
            for view in self.setup.views
        }

    @cached_property
    def tolerated(self) -> dict[str, float]:
        """Stage -> energy that nuisances take away within their boxes, without any effect."""
        raw = self.search.energies(replace(self.choice.null_model, nuisance=0 * self.choice.null_model.nuisance))
        return {s: max(raw[s] - e, 0.0) for s, e in self.choice.energies[0].items()}

    @cached_property
    def bent(self) -> dict[str, float]:
        """Stage -> energy by which tolerated nuisances are off straight lines, where that matters (`beside_most`)."""
        most, (_, after), fit = self.thresholds.beside_most, self.choice.energies, self.choice.chosen
        rest = {view.stage: max(after[view.stage] - 1, self.structures[view.stage].energy) for view in self.setup.views}
        return {stage: self.setup.bent(stage, fit) for stage, energy in rest.items() if energy > most}

    @cached_property
    def decision(self) -> Decision:
        """What it amounts to."""
        return self.decided({})

    def decided(self, signs: Mapping[str, Structure]) -> Decision:
        """What it amounts to, given signs of tests that its customer has of its own (see `decide`)."""
        shares = {stage: share for stage, (share, _) in self.flexible.items()}
        return decide(self.choice, shares, self.structures, self.tolerated, self.thresholds, signs, self.bent)

    @cached_property
    def null_left(self) -> dict[str, NDArray[np.float32]]:
        """Stage -> what nuisances alone leave, [M, S]."""
        return dict(zip(self.stages, self.setup.residuals(self.plain, self.choice.null_model), strict=True))
