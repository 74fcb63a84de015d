"""A single-stage table to a diagnosis: views in, the engine, a verdict out."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from softarm.common.processes import as_they_come
from softarm.diagnosis.data.trials import Trial, TrialError
from softarm.diagnosis.engine.confidence import confidence, margins
from softarm.diagnosis.engine.decision import Decision, Kind
from softarm.diagnosis.engine.examination import Examination
from softarm.diagnosis.engine.held_out import block_sums
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.result import Diagnosis, HeldOut, Leftover, Overlay, Regime, Rival
from softarm.diagnosis.engine.search import Progress, SelectedEffect
from softarm.diagnosis.engine.thresholds import RIG, SHOTS
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.rigs import evidence, experiments
from softarm.diagnosis.rigs.candidates import candidates, nuisances
from softarm.diagnosis.rigs.chain.view import ChainView
from softarm.diagnosis.rigs.driven_mass import DrivenMassView
from softarm.diagnosis.rigs.tracking import TrackingView, velocity_warnings
from softarm.diagnosis.rigs.views import RigView
from softarm.diagnosis.rigs.vocabulary import Effect
from softarm.schemas.verdict import (
    Estimate,
    Gap,
    Interval,
    NamedEffect,
    NextExperiment,
    Quantity,
    Shrink,
    Verdict,
    Where,
)


class ViewClass(Protocol):
    """What a kind of stage brings: `RigView`s made of trials, and how a trial is cut before that."""

    def __call__(self, trials: Sequence[Trial], /) -> RigView:
        """The view; raises TrialError for what it cannot be made of."""

    def shots(self, trial: Trial, /) -> tuple[Trial, ...]:
        """See RigView."""


# A new kind of stage is a line here.
VIEWS: Mapping[str, ViewClass] = {
    "tracking": TrackingView,
    "driven_mass": DrivenMassView,
    "pendulum": ChainView,
    "chain": ChainView,
}

TRIALS_LEAST = 4  # recordings from which on whole ones are left out while searching
_WEAK = {
    "kind": "",
    "trial": "what is said of unseen data is of other trials of the same kind of motion: record several kinds",
    "block": "what is said of unseen data is of blocks of the same trial, the weakest of tests: record more trials",
}


@dataclass(frozen=True, slots=True)
class Finding:
    """What was found of one stage."""

    stage: str
    unit: str
    before: float  # RMS, nominal
    after: float  # RMS with the named effects, held out
    floor: float  # RMS that nobody is blamed for
    ceiling: float  # RMS with any model at all
    energy: float  # of the nominal gap, in floors
    regime: str
    decision: Decision
    named: tuple[NamedEffect, ...]
    nuisances: Mapping[str, float]
    overlays: tuple[Overlay, ...]
    regimes: tuple[Regime, ...]
    rivals: tuple[Rival, ...]
    leans: tuple[tuple[str, float], ...]
    following: NextExperiment | None
    units: Mapping[str, str]  # of every parameter of the vocabulary
    together: Interval | None  # share of the RMS that goes with all named effects
    held_out: HeldOut
    vocabulary: tuple[Effect, ...]
    warnings: tuple[str, ...]


def diagnose_table(trials: Sequence[Trial], tell: Progress = lambda text, share: None, processes: int = 1) -> Diagnosis:
    """Diagnose every stage of a table's trials, each alone; deterministic.

    tell: what is being done, and how far it is (0 to 1). processes: stages at a time. Raises TrialError for trials of
    no table, and for kinds that have no view yet.
    """
    started = time.monotonic()
    names = sorted({t.stage.name for t in trials if t.stage is not None})
    if not names or any(t.stage is None for t in trials):
        raise TrialError("these trials are of no single-stage table; diagnose recordings of the robot by their own way")
    own = {name: tuple(t for t in trials if t.stage is not None and t.stage.name == name) for name in names}
    tell(names[0], 0.0)
    found: dict[str, Finding] = {}
    for mine, finding in as_they_come(examine, tuple(own.values()), processes):
        tell(finding.stage, (len(found) + 1) / len(names))
        found[mine[0].stage.name if mine[0].stage else ""] = finding
    stages = [found[name] for name in names]
    tracking = [t for t in trials if t.stage is not None and t.stage.kind == "tracking"]
    warnings = [*dict.fromkeys(w for t in trials for w in t.warnings), *velocity_warnings(tracking)]
    warnings += [text for stage in stages for text in stage.warnings]
    return Diagnosis(
        verdict=verdict_of(stages, tuple(dict.fromkeys(warnings))),
        nominal=None,
        patched=None,
        trials=tuple((t.name, t.kind, t.duration_s) for t in trials),
        overlays=tuple(overlay for stage in stages for overlay in stage.overlays),
        regimes=tuple(regime for stage in stages for regime in stage.regimes),
        rivals=tuple(rival for stage in stages for rival in stage.rivals),
        leftovers=tuple(Leftover(s.stage, s.decision.explained, s.leans) for s in stages),
        nuisances={path: value for s in stages for path, value in s.nuisances.items()},
        units={path: unit for s in stages for path, unit in s.units.items()},
        seconds=time.monotonic() - started,
        together={s.stage: s.together for s in stages if s.together is not None},
        held_out=min((s.held_out for s in stages), key=("block", "trial", "kind").index),
        margins={n: m for s in stages if s.decision.kind == "named" for n, m in margins(s.decision.selected).items()},
        vocabulary={effect.name: effect for s in stages for effect in s.vocabulary},
    )


def view_of(trials: Sequence[Trial]) -> tuple[RigView, tuple[Trial, ...], tuple[int, ...]]:
    """A stage's view, its trials in the view's order, and the recording that each was cut from."""
    kind = trials[0].stage.kind if trials[0].stage is not None else ""
    if kind not in VIEWS:
        raise TrialError(f"{trials[0].source}: a {kind} stage cannot be diagnosed yet; {' and '.join(VIEWS)} can")
    cut = [(k, shot) for k, trial in enumerate(trials) for shot in VIEWS[kind].shots(trial)]
    shots = tuple(shot for _, shot in cut)
    return VIEWS[kind](shots), shots, tuple(k for k, _ in cut)


def examine(trials: Sequence[Trial]) -> Finding:
    """One stage."""
    view, ordered, origins = view_of(trials)
    kinds = [t.kind for t in ordered]
    setup = Setup([view], nuisances(view), kinds, origins, view.block_s)
    thresholds = SHOTS if view.fits_starts and len(trials) >= TRIALS_LEAST else RIG
    thresholds = replace(thresholds, anew=view.own_wells)
    found = Examination(setup, candidates(view), kinds, thresholds, lambda text, share: None)
    return _Stage(view, ordered, origins, found).finding()


class _Stage:
    """From an examination to what is said of it."""

    def __init__(self, view: RigView, trials: tuple[Trial, ...], origins: tuple[int, ...], found: Examination) -> None:
        self.view, self.trials, self.origins, self.found = view, trials, origins, found
        self.choice, self.decision = found.choice, found.decision
        self.nominal: Array = view.gap([{}])[0].astype(float)
        self.left: Array = found.left[view.stage].astype(float)
        spared = found.search.spared(self.choice.chosen, self.choice.null_model)
        self.without = dict(zip(self.choice.chosen.names, found.judged(spared), strict=True))

    def finding(self) -> Finding:
        """Everything."""
        view, decision = self.view, self.decision
        patched = self.left if decision.selected else None
        before, inside = evidence.rms(self.nominal), evidence.rms(self.left)
        spoiled = self.choice.chosen.held_out.sum() / max(self.choice.chosen.loss, 1e-12)
        after = min(inside * math.sqrt(max(spoiled, 1.0)), before) if decision.selected else before
        share = self.found.flexible.get(view.stage, (0.0, {}))
        floor = float(np.sqrt(np.mean(view.floor**2)))
        regimes = evidence.regime_rows(view, self.nominal, patched)
        worst = max(regimes, key=lambda r: r.nominal_rms, default=None)
        return Finding(
            stage=view.stage,
            unit=view.unit,
            before=before,
            after=after,
            floor=floor,
            ceiling=min(inside * math.sqrt(1 - share[0]), after),
            energy=(before / float(np.sqrt(np.mean(view.floor**2)))) ** 2,
            regime="everywhere" if worst is None else f"most where: {worst.name}",
            decision=decision,
            named=tuple(self._named(m) for m in decision.selected),
            nuisances=self.found.setup.fitted_nuisances(self.choice.chosen),
            overlays=tuple(evidence.overlays(view, self.trials, self.nominal, patched)),
            regimes=tuple(regimes),
            rivals=tuple(
                evidence.rivals(self.found.search, self.found.searched, self.choice.null_model, decision.selected)
            ),
            leans=tuple(share[1].items()),
            following=experiments.splitting(view, [self._same(m) for m in decision.selected]),
            units={f"{e.name}.{p.name}": p.unit for e in view.effects for p in e.parameters},
            together=self._together() if decision.selected else None,
            held_out=self.found.setup.unseen,
            vocabulary=view.effects,
            warnings=tuple(self._warnings()),
        )

    def _together(self) -> Interval:
        """Share of the RMS that goes from the nominal gap to what all named effects leave, held out."""
        raw = block_sums(self.found.search.problem, [{}])[0][0]
        return evidence.shrunk(
            evidence.summed(self.found.search, raw, self.origins),
            evidence.by_trial(self.found.search, self.choice.chosen, self.origins),
        )

    def _named(self, effect: SelectedEffect) -> NamedEffect:
        less = evidence.by_trial(self.found.search, self.without[effect.candidate.name], self.origins)
        more = evidence.by_trial(self.found.search, self.choice.chosen, self.origins)
        return NamedEffect(
            name=effect.candidate.name,
            parameters=self._estimates(effect),
            # Beside what stays without a name each may stand in for it; how often is not measured.
            confidence=confidence("rig", effect) if self.decision.kind == "named" else None,
            equivalents=self._same(effect)[1:],
            shrink=Shrink(stage=evidence.shrunk(less, more)),
        )

    def _same(self, effect: SelectedEffect) -> tuple[str, ...]:
        """An effect and all that these data, or any of such a stage, cannot tell from it."""
        told = (effect.candidate.name, *effect.equivalents)
        return tuple(dict.fromkeys((*told, *(twin for name in told for twin in self.view.twins.get(name, ())))))

    def _estimates(self, effect: SelectedEffect) -> dict[str, Estimate]:
        chosen = self.choice.chosen
        at = chosen.names.index(effect.candidate.name)
        first = sum(len(each.parameters) for each in chosen.effects[:at])
        bounds = self.found.search.problem.interval(chosen, self.found.thresholds.inexact)
        known = self.view.known_to(chosen.point)
        found = {}
        for i, (parameter, u) in enumerate(zip(effect.candidate.parameters, chosen.u[at], strict=True)):
            least = known.get(parameter.path.partition(".")[2], 0.0)
            ends = [min(float(bounds[0][first + i]), u - least), max(float(bounds[1][first + i]), u + least)]
            if least > 0:  # where nothing tells, a fit's line is flat and says nothing either: the next sample does
                ends = [max(ends[0], u - 2 * least), min(ends[1], u + 2 * least)]
            form = self.view.forms.get(parameter.path.partition(".")[2], 0.0)
            ends = [u - math.hypot(u - ends[0], form), u + math.hypot(ends[1] - u, form)]
            ends = [min(max(x, parameter.low), parameter.high) for x in ends]
            values = [parameter.value(x) for x in (u, *ends)]
            value, low, high = (x if math.isfinite(x) else 1e12 for x in (values[0], min(values), max(values)))
            found[parameter.path.rpartition(".")[2]] = Estimate(value=value, low=low, high=high, unit=parameter.unit)
        return found

    def _warnings(self) -> list[str]:
        """What a reader of the verdict has to know of this stage."""
        stage, found = self.view.stage, list(self.view.warnings)
        how: HeldOut = self.found.setup.unseen
        if self.decision.selected and _WEAK[how]:
            found.append(f"{stage}: {_WEAK[how]}")
        for effect in self.choice.selected:
            name = effect.candidate.name
            if effect not in self.decision.selected:
                found.append(f"{name} shrinks the gap and leaves more than it explains: it is not named")
            elif effect.bounded:
                found.append(
                    f"{name}: {', '.join(effect.bounded)} would explain as much at the end of its range; that end "
                    "may be all that rules it out, so nobody can say how sure this name is"
                )
        if self.decision.odd and self.decision.selected:
            found.append(f"{stage}: what is left is no noise ({'; '.join(self.decision.odd.values())})")
        damping = self.found.setup.fitted_nuisances(self.choice.chosen).get(f"{stage}.damping.scale")
        if damping is not None and self.decision.selected and damping < -0.9:
            found.append(
                f"{stage}: beside the named effects nothing is left of the model's viscous friction "
                f"(damping x {max(1 + damping, 0.0):.2g}): it stood in for them"
            )
        return found


def verdict_of(stages: Sequence[Finding], warnings: Sequence[str]) -> Verdict:
    """All stages together."""
    gaps = [s for s in stages if s.decision.kind != "none"]
    kinds = {s.decision.kind for s in gaps}
    answer: Kind = "none"
    if gaps:
        answer = kinds.pop() if len(kinds) == 1 else "incomplete"
    total = sum(s.energy for s in stages)
    where = max(gaps, key=lambda s: s.energy) if gaps else None

    def each(value: Callable[[Finding], float]) -> dict[str, Quantity]:
        return {s.stage: Quantity(value=value(s), unit=s.unit) for s in stages}

    return Verdict(
        verdict=answer,
        where=Where(
            stage=where.stage if where else None,
            share={s.stage: s.energy / total if total else 0.0 for s in stages},
            regime=where.regime if where else "nowhere: the gap is within the floor",
        ),
        effects=tuple(effect for s in stages for effect in s.named),
        gap=Gap(
            before=each(lambda s: s.before),
            after=each(lambda s: s.after),
            floor=each(lambda s: s.floor),
            ceiling=each(lambda s: s.ceiling),
        ),
        next_experiment=next((s.following for s in gaps if s.following is not None), None),
        warnings=tuple(warnings),
    )
