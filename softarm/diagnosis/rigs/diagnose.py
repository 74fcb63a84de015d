"""Diagnosis of the trials of one rig, each of its stages on its own."""

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from softarm.common.processes import as_they_come
from softarm.common.quantity import PURE
from softarm.diagnosis.answer import rivals
from softarm.diagnosis.answer.assembly import StageAnswer, assemble, gap_of, share
from softarm.diagnosis.answer.calibration import Calibrated, calibrated
from softarm.diagnosis.answer.evidence import overlays, regimes, rms
from softarm.diagnosis.data.trials import Trial, stage_of
from softarm.diagnosis.engine import shrink
from softarm.diagnosis.engine.calibration import held_out_squares
from softarm.diagnosis.engine.confidence import confidence, margins
from softarm.diagnosis.engine.decision import Decision, Kind
from softarm.diagnosis.engine.examination import Examination
from softarm.diagnosis.engine.fits import Fit
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.result import Diagnosis, HeldOut, Rival, Unexplained
from softarm.diagnosis.engine.search import SelectedEffect
from softarm.diagnosis.engine.thresholds import RIG, WINDOWED
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.engine.work import Progress
from softarm.diagnosis.rigs import experiments, subsample
from softarm.diagnosis.rigs.candidates import candidates, nuisances
from softarm.diagnosis.rigs.chain.view import ChainView
from softarm.diagnosis.rigs.driven_mass import DrivenMassView
from softarm.diagnosis.rigs.mjcf.view import JointView
from softarm.diagnosis.rigs.subsample import Stretches
from softarm.diagnosis.rigs.tracking import TrackingView, velocity_warnings
from softarm.diagnosis.rigs.views import RigView
from softarm.schemas.verdict import (
    BestFit,
    CalibratedParameter,
    Estimate,
    Interval,
    NamedEffect,
    NextExperiment,
    Quantity,
    Shrink,
    Verdict,
    Where,
)
from softarm.simulator.effects import Effect

# Kind of stage -> its view. A new kind is one more line.
VIEWS: Mapping[str, type[TrackingView | DrivenMassView | ChainView | JointView]] = {
    "tracking": TrackingView,
    "driven_mass": DrivenMassView,
    "pendulum": ChainView,
    "chain": ChainView,
    "mujoco": JointView,
}

# Windows in which small errors grow too much are halved at most so many times.
HALVINGS = 3
# Shares of a stage's time at which its search begins and ends.
BEGUN, SEARCHED = 0.05, 0.9
# With at least this many recordings, the search holds out whole recordings instead of blocks.
TRIALS_LEAST = 4
# Repeats of a search whose budget binds.
RESTARTS_BOUND = 1
# Effects of a whole mechanism, which each joint shows on its own.
_COMMON = {"tilt": "a base that is not level", "payload": "a load at the end"}
_WEAK_HELD_OUT = {
    "kind": "",
    "trial": "held-out data are other trials of the same kind of motion; record several kinds",
    "block": "held-out data are blocks of the same trial, which is the weakest test; record more trials",
}


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of the diagnosis of one stage."""

    answer: StageAnswer
    energy: float  # squared nominal residual over the squared noise floor
    regime: str
    decision: Decision
    named: tuple[NamedEffect, ...]
    calibration: tuple[CalibratedParameter, ...]
    best_fit: BestFit | None
    rivals: tuple[Rival, ...]
    following: NextExperiment | None
    held_out: HeldOut
    vocabulary: tuple[Effect, ...]
    warnings: tuple[str, ...]
    driven_by: frozenset[str]  # stages whose measured motion loads this stage

    @property
    def is_unexplained(self) -> bool:
        """Return whether more than noise remains of the gap."""
        return self.decision.kind in ("unknown", "incomplete") or self.decision.noise

    def rated(self, found: Mapping[str, "Finding"]) -> "Finding":
        """Return the finding without confidences if the motion that loads its stage is doubtful; found: by stage.

        A wrong encoder of a driven joint shows in the joint that carries it, where other effects resemble it.
        """
        doubtful = [name for name in sorted(self.driven_by & found.keys()) if found[name].is_unexplained]
        if not doubtful or all(effect.confidence is None for effect in self.named):
            return self
        text = (
            f"{self.answer.stage}: not rated, because the measured motion of {', '.join(doubtful)} loads it and has a "
            "gap of its own without a cause"
        )
        named = tuple(effect.model_copy(update={"confidence": None}) for effect in self.named)
        return replace(self, named=named, warnings=(*self.warnings, text))


def diagnose_table(
    trials: Sequence[Trial],
    report: Progress = lambda text, share: None,
    processes: int = 1,
    budget_s: float = math.inf,
) -> Diagnosis:
    """Diagnose every stage of a rig's trials on its own; the result is deterministic.

    Args:
        trials: trials read from a stage.yaml.
        report: called with the current step and the finished share, 0 to 1.
        processes: number of stages diagnosed at the same time.
        budget_s: processor time for all stages together, s; of longer recordings only stretches are used.

    Raises:
        TrialError: if a trial lacks a column, or its model a value.
    """
    started = time.monotonic()
    own: dict[str, list[Trial]] = {}
    for trial in trials:
        own.setdefault(stage_of([trial]).name, []).append(trial)
    names = sorted(own)
    report(names[0], 0.0)
    found: dict[str, Finding] = {}
    work = partial(examine, budget_s=budget_s / len(names))
    if processes == 1 or len(names) == 1:  # another process cannot report its steps

        def within(text: str, share: float) -> None:
            report(text, (len(found) + BEGUN + (SEARCHED - BEGUN) * share) / len(names))

        work = partial(work, report=within)
    for _, finding in as_they_come(work, [own[name] for name in names], processes):
        found[finding.answer.stage] = finding
        report(finding.answer.stage, len(found) / len(names))
    stages = [found[name].rated(found) for name in names]
    warnings = [*dict.fromkeys(w for t in trials for w in t.warnings), *velocity_warnings(trials)]
    warnings += [text for stage in stages for text in stage.warnings]
    warnings += common_causes(stages)
    answers = [stage.answer for stage in stages]
    return replace(
        assemble(_verdict(stages, answers, warnings), answers, trials, started),
        rivals=tuple(rival for s in stages for rival in s.rivals),
        margins={
            name: x for s in stages if s.decision.kind == "named" for name, x in margins(s.decision.selected).items()
        },
        held_out=min((s.held_out for s in stages), key=("block", "trial", "kind").index),
        units={f"{e.name}.{p.name}": p.unit for s in stages for e in s.vocabulary for p in e.parameters},
        vocabulary={effect.name: effect for s in stages for effect in s.vocabulary},
    )


def common_causes(stages: Sequence[Finding]) -> Iterator[str]:
    """Yield a warning for each effect of the whole mechanism that may explain the gaps of several stages."""
    names = {name for s in stages for effect in s.named for name in (effect.name, *effect.equivalents)}
    for law, words in _COMMON.items():
        shown = [s.answer.stage for s in stages if f"{s.answer.stage}.{law}" in names]
        if len(shown) > 1:
            yield f"{', '.join(shown)}: {words} may be the one cause of these gaps; check it first"


def _verdict(stages: Sequence[Finding], answers: Sequence[StageAnswer], warnings: Sequence[str]) -> Verdict:
    """Return the verdict on all stages of a rig."""
    gaps = [s for s in stages if s.decision.kind != "none"]
    kinds = {s.decision.kind for s in gaps}
    kind: Kind = "none"
    if gaps:
        kind = kinds.pop() if len(kinds) == 1 else "incomplete"
    total = sum(s.energy for s in stages)
    worst = max(gaps, key=lambda s: s.energy, default=None)
    return Verdict(
        verdict=kind,
        where=Where(
            stage=worst.answer.stage if worst else None,
            share={s.answer.stage: s.energy / total if total else 0.0 for s in stages},
            regime=worst.regime if worst else "nowhere: the gap is within the noise floor",
        ),
        effects=tuple(effect for s in stages for effect in s.named),
        calibration=tuple(each for s in stages for each in s.calibration),
        best_fit={s.answer.stage: s.best_fit for s in stages if s.best_fit is not None},
        gap=gap_of(answers),
        next_experiment=next((s.following for s in gaps if s.following is not None), None),
        warnings=tuple(dict.fromkeys(warnings)),
        equal_sets=tuple(names for s in stages for names in s.decision.equal_sets),
    )


def view_of(trials: Sequence[Trial]) -> tuple[RigView, Stretches]:
    """Return a stage's view and its windows, in the view's order."""
    kind = VIEWS[stage_of(trials).kind]
    windows = Stretches(tuple(trials), tuple(range(len(trials)))).cut_into(map(kind.windows, trials))
    view: RigView = kind(windows.trials)
    for times in range(1, HALVINGS + 1):
        if not (growing := view.growing):
            break
        parts = [view.halves(i, times) if i in growing else (trial,) for i, trial in enumerate(windows.trials)]
        windows = windows.cut_into(parts)
        view = kind(windows.trials)
    return view, windows


def examine(
    trials: Sequence[Trial], budget_s: float = math.inf, report: Progress = lambda text, share: None
) -> Finding:
    """Diagnose one stage from its trials, or from the most informative stretches if the budget binds."""
    view, used = view_of(trials)
    notes: tuple[str, ...] = ()
    if (reduced := subsample.within(budget_s, view, used)) is not None:
        used, note = reduced
        view, notes = VIEWS[stage_of(trials).kind](used.trials), (note,)
    kinds = [t.kind for t in used.trials]
    setup = settled(view, kinds, used.origins)
    thresholds = WINDOWED if view.fits_starts and len(set(used.origins)) >= TRIALS_LEAST else RIG
    search = replace(thresholds.search, refit=view.restarts_few_effects)
    if notes:  # each repeat costs as much as the search
        search = replace(search, restarts=RESTARTS_BOUND)
    thresholds = replace(thresholds, search=search)
    found = Examination(setup, candidates(view), thresholds, report, partial(widened, view))
    finding = _Stage(view, used, found).finding()
    return replace(finding, warnings=(*notes, *finding.warnings))


def settled(view: RigView, kinds: Sequence[str], origins: Sequence[int]) -> Setup:
    """Return the problem of a view; each curved parameter gets the value that leaves the smallest gap."""

    def setup() -> Setup:
        return Setup([view], nuisances(view), kinds, origins, view.block_s)

    for path, values in view.curved.items():
        losses = []
        for value in values:
            view.assume(path, value)
            losses.append(setup().plain().losses([((), ())])[0])
        view.assume(path, values[int(np.argmin(losses))])
    return setup()


def widened(view: RigView, fit: Fit, low: Array, high: Array) -> tuple[Array, Array]:
    """Return the interval of a fit's parameters with what the view cannot resolve and the uncertainty of its laws."""
    paths = [d.path.partition(".")[2] for each in fit.effects for d in each.parameters]
    u = np.array([x for us in fit.u for x in us])
    widths = view.unresolved(fit.point), view.model_uncertainty
    flat, law = (np.array([width.get(path, 0.0) for path in paths]) for width in widths)
    # The loss is flat over an unresolved range, so the fit's interval means nothing there.
    below, above = (np.where(flat > 0, np.clip(half, flat, 2 * flat), half) for half in (u - low, high - u))
    return u - np.hypot(below, law), u + np.hypot(above, law)


class _Stage:
    """Assembly of a stage's finding from the examination of its view."""

    def __init__(self, view: RigView, used: Stretches, found: Examination) -> None:
        self.view, self.trials, self.origins, self.found = view, used.trials, used.origins, found
        self.choice, self.decision = found.choice, found.decide()
        self.fit = found.named(self.decision)
        self._units = {f"{e.name}.{p.name}": p.unit for e in view.effects for p in e.parameters}
        self.calibrated = self._calibrated(self.fit)
        self.best_fit = self._best_fit()
        self.nominal: Array = view.gap([{}])[0].astype(float)
        self.without = found.without_each(self.fit)
        self.left_squares = self._squares(self.fit)

    def finding(self) -> Finding:
        """Return the complete finding."""
        view, decision, found = self.view, self.decision, self.found
        answer = self._answer()
        worst = max(regimes(view, self.nominal, None), key=lambda r: r.nominal_rms, default=None)
        regime = "throughout" if worst is None else f"largest: {worst.name}"
        return Finding(
            answer=answer,
            energy=(answer.before / answer.floor) ** 2,
            regime=found.slow[view.stage].where if found.slow else regime,
            decision=decision,
            named=tuple(self._named(m) for m in decision.selected),
            calibration=self.calibrated.parameters,
            best_fit=self.best_fit,
            rivals=rivals.by_share(found, decision),
            following=experiments.splitting(view, [self._same(m) for m in decision.selected]),
            held_out=found.setup.held_out,
            vocabulary=view.effects,
            warnings=tuple(self._warnings()),
            driven_by=view.driven_by,
        )

    def _calibrated(self, fit: Fit) -> Calibrated:
        """Return the calibration next to the effects of a fit."""
        found = self.found
        return calibrated(found.setup, found.verdict_problem, found.plain, fit, self._unit)

    def _unit(self, path: str) -> str:
        return self._units.get(path, PURE)

    def _best_fit(self) -> BestFit | None:
        """Return the effects that predict best if the named ones, which leave a gap, predict less or change others."""
        if self.decision.kind not in ("incomplete", "unknown"):
            return None
        stage, best = self.view.stage, self.found.search.predicting(self.choice.chosen, self.view.shared)
        if best is None or not best.effects:
            return None
        (fit,) = self.found.held_out([best])
        tuned = self._calibrated(fit)
        shares = any(name.rpartition(".")[2] in self.view.shared for name in self.fit.names)
        if tuned.rms[stage] >= self.calibrated.rms[stage] and not shares:
            return None
        values = {path: x for path, x in {**tuned.values, **fit.point}.items() if math.isfinite(x)}
        return BestFit(
            parameters={path: Quantity(value=x, unit=self._unit(path)) for path, x in values.items()},
            after=Quantity(value=tuned.rms[stage], unit=self.view.unit),
        )

    def _answer(self) -> StageAnswer:
        view, found, fit = self.view, self.found, self.fit
        patched = view.gap([fit.point])[0].astype(float) if fit.effects else None
        before = after = rms(self.nominal)
        if patched is not None:
            after = min(math.sqrt(float(self.left_squares.sum() / np.isfinite(view.measured).sum())), before)
        flexible, features = found.flexible.get(view.stage, (0.0, {}))
        return StageAnswer(
            stage=view.stage,
            unit=view.unit,
            before=before,
            after=after,
            floor=self._floor(),
            calibrated=self.calibrated.rms[view.stage],
            ceiling=min(rms(found.residuals[view.stage].astype(float)) * math.sqrt(1 - flexible), after),
            overlays=overlays(view, self.trials, self.nominal, patched, self.calibrated.residuals.get(view.stage)),
            regimes=regimes(view, self.nominal, patched),
            unexplained=Unexplained(view.stage, self.decision.explained, tuple(features.items())),
            total_shrink=None if patched is None else self._shrink(found.choice.null_model),
        )

    def _floor(self) -> float:
        """Return the noise floor, RMS; without an effect, what the calibrated model leaves is noise."""
        estimated = float(np.sqrt(np.mean(self.view.floor**2)))
        if self.decision.kind != "none":
            return estimated
        return max(estimated, rms(self.found.null_residuals[self.view.stage].astype(float)))

    def _squares(self, fit: Fit) -> Array:
        """Return the squares of the gap by recording, [K], or by block if there is only one recording.

        Each block is simulated with the effects that were fitted without its fold, and without calibration.
        """
        problem, origins = self.found.verdict_problem, self.origins
        nominal = np.zeros((len(np.unique(problem.fold)), len(problem.nuisance_low)))
        squares = held_out_squares(self.found.setup, self.found.plain, fit, nominal)[self.view.stage]
        if len(set(origins)) < 2:
            return squares
        found = np.zeros(max(origins) + 1)
        np.add.at(found, [origins[window] for window, _ in problem.blocks], squares)
        return found

    def _shrink(self, less: Fit) -> Interval:
        """Return the share of the held-out RMS that is lost with fewer effects."""
        return share(*shrink.interval(self._squares(less), self.left_squares))

    def _named(self, effect: SelectedEffect) -> NamedEffect:
        return NamedEffect(
            name=effect.candidate.name,
            parameters=self._estimates(effect),
            # Next to an unexplained residual any effect may stand in for its cause; how often is not measured.
            confidence=confidence("rig", effect) if self.decision.kind == "named" else None,
            equivalents=self._same(effect)[1:],
            shrink=Shrink(stage=self._shrink(self.without[effect.candidate.name])),
        )

    def _same(self, effect: SelectedEffect) -> tuple[str, ...]:
        """Return an effect and all effects that these data, or any data of such a stage, cannot separate from it."""
        names = (effect.candidate.name, *effect.equivalents)
        others = (other for name in names for other in self.view.indistinguishable.get(name, ()))
        return tuple(dict.fromkeys((*names, *others)))

    def _estimates(self, effect: SelectedEffect) -> dict[str, Estimate]:
        fit, found = self.fit, {}
        at = fit.names.index(effect.candidate.name)
        first, bounds = sum(len(each.parameters) for each in fit.effects[:at]), self.found.interval(fit)
        for i, (parameter, u) in enumerate(zip(effect.candidate.parameters, fit.u[at], strict=True), first):
            ends = [min(max(float(bound[i]), parameter.low), parameter.high) for bound in bounds]
            values = [parameter.value(x) for x in (u, *ends)]
            found[parameter.path.rpartition(".")[2]] = Estimate(
                value=values[0], low=min(values), high=max(values), unit=parameter.unit
            )
        return found

    def _warnings(self) -> list[str]:
        stage, found = self.view.stage, list(self.view.warnings(self.fit.point))
        how: HeldOut = self.found.setup.held_out
        if self.decision.selected and _WEAK_HELD_OUT[how]:
            found.append(f"{stage}: {_WEAK_HELD_OUT[how]}")
        found += rivals.not_named(self.choice, self.decision)
        found += rivals.not_rated(self.decision)
        if self.best_fit is not None:
            left = 100 * self.best_fit.after.value / rms(self.nominal)
            effects = ", ".join(dict.fromkeys(path.split(".")[1] for path in self.best_fit.parameters))
            found.append(
                f"{stage}: the best fit ({effects}) leaves {left:.0f} % of the gap, held out; a model, no diagnosis: "
                "--patch FILE --best-fit writes it"
            )
        if self.decision.structure and (self.decision.selected or self.found.slow):
            found.append(f"{stage}: the residual is not noise ({'; '.join(self.decision.structure.values())})")
        if self.decision.noise:
            ratio = self._floor() / float(np.sqrt(np.mean(self.view.floor**2)))
            found.append(
                f"{stage}: the noise floor is what the model leaves, {ratio:.2g} times the estimate from the signals; "
                "a flexible model explains nothing of it beyond chance on held-out data"
            )
        damping = self.found.setup.fitted_nuisances(self.fit).get(f"{stage}.damping.scale")
        if damping is not None and self.decision.selected and damping < -0.9:
            found.append(
                f"{stage}: with the named effects, the model's viscous friction vanishes "
                f"(damping x {max(1 + damping, 0.0):.2g}); it had replaced them"
            )
        return found
