"""Losses of sets of effects as the sensitivities at a fit predict them, without further simulations."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from softarm.diagnosis.engine import box
from softarm.diagnosis.engine.candidates import Candidate, Coordinates, EffectSet, joined, parameters_of, split
from softarm.diagnosis.engine.fits import Fit, FitProblem


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
        self._problem, self.effects = problem, (*fit.effects, *options)
        u = (*fit.u, *(tuple(d.nominal for d in each.parameters) for each in options))
        self._normal, self._slope = problem.sensitivities(replace(fit, effects=self.effects, u=u))
        self._x = joined(u)
        self._owner = np.repeat(np.arange(len(self.effects)), [len(each.parameters) for each in self.effects])

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
