"""Baselines of the diagnosis with the same simulator and protocol.

They have no ceiling, no whitening and no rivals.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from softarm.diagnosis.data.trials import Trial
from softarm.diagnosis.engine.candidates import split
from softarm.diagnosis.engine.fits import Fit
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.result import Diagnosis
from softarm.diagnosis.engine.search import Search
from softarm.diagnosis.robot.candidates import candidates, nuisances
from softarm.diagnosis.robot.trial_grid import on_grid
from softarm.diagnosis.robot.views import robot_views
from softarm.schemas.model import Model
from softarm.schemas.verdict import Estimate, Gap, Interval, NamedEffect, Shrink, Verdict, Where
from softarm.simulator.effects import REGISTRY

GAIN_MIN = 0.1  # smallest gain of `largest_gain`, as a share of the misfit
CLEARLY = 1.96  # smallest distance from nominal of `all_at_once`, in half intervals


def largest_gain(trials: Sequence[Trial], model: Model) -> Diagnosis:
    """Return the effect that, alone, lowers the nominal misfit most."""
    search = _search(trials, model)
    null_model = search.problem.fit([((), ())])[0]
    best = min(search.extended(null_model), key=lambda f: f.loss)
    return _named(best if best.loss < (1 - GAIN_MIN) * null_model.loss else null_model, model)


def all_at_once(trials: Sequence[Trial], model: Model) -> Diagnosis:
    """Fit all parameters together and return the effect that differs most significantly from nominal."""
    search = _search(trials, model)
    known = {c.name: c for c in reversed(search.candidates)}
    effects = tuple(known[name] for name in REGISTRY if name in known)
    # Effects with a kink have no slope where they are absent, so all start slightly present.
    start = tuple(tuple(min(max(d.nominal + 0.1 * d.size, d.low), d.high) for d in c.parameters) for c in effects)
    fit = search.problem.fit([(effects, start)], rounds=6)[0]
    low, high = search.problem.interval(fit)
    ranked = []
    for effect, us, half in zip(fit.effects, fit.u, split(fit.effects, (high - low) / 2), strict=True):
        sizes = zip(us, effect.parameters, half, strict=True)
        ranked.append((max(abs(u - d.nominal) / max(h, 1e-9 * d.size) for u, d, h in sizes), effect, us))
    clear, effect, us = max(ranked, key=lambda each: each[0])
    if clear > CLEARLY:
        return _named(replace(fit, effects=(effect,), u=(us,)), model)
    return _named(replace(fit, effects=(), u=()), model)


def _search(trials: Sequence[Trial], model: Model) -> Search:
    ordered = sorted(trials, key=lambda trial: trial.name)
    views = robot_views(on_grid(ordered, model), model)
    setup = Setup(views, nuisances(model), [trial.kind for trial in ordered])
    return Search(setup.weighed(), setup.plain(), [view.stage for view in views], candidates(model))


def _named(fit: Fit, model: Model) -> Diagnosis:
    """Return a diagnosis that names all effects of a fit; the patched model is the nominal one with them."""
    effects = []
    for candidate, us in zip(fit.effects, fit.u, strict=True):
        parameters = {
            d.path.rpartition(".")[2]: Estimate(value=d.value(u), low=d.value(u), high=d.value(u), unit=d.unit)
            for d, u in zip(candidate.parameters, us, strict=True)
            if np.isfinite(d.value(u))
        }
        unknown = Interval(value=0.0, low=0.0, high=0.0)  # baselines do not measure the shrink
        effects.append(NamedEffect(name=candidate.name, parameters=parameters, shrink=Shrink(stage=unknown)))
    stage = REGISTRY[effects[0].name].stage if effects else None
    where = Where(stage=stage, share={stage: 1.0} if stage else {}, regime="not asked")
    empty = Gap(before={}, after={}, floor={}, ceiling={})
    verdict = Verdict(verdict="named" if effects else "none", where=where, effects=tuple(effects), gap=empty)
    named = {each.name: {name: estimate.value for name, estimate in each.parameters.items()} for each in effects}
    patched = model.model_copy(update={"effects": {**model.effects, **named}})
    return Diagnosis(verdict, model, patched)
