"""Diagnosis of one stage of a rig."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import cast

import numpy as np

from softarm.common.quantity import PURE
from softarm.diagnosis.answer import rivals
from softarm.diagnosis.answer.assembly import StageAnswer, share
from softarm.diagnosis.answer.calibration import Calibrated, calibrated
from softarm.diagnosis.answer.evidence import overlays, regimes, rms
from softarm.diagnosis.data.trials import Trial, stage_of
from softarm.diagnosis.engine import shrink
from softarm.diagnosis.engine.calibration import held_out_squares
from softarm.diagnosis.engine.confidence import confidence
from softarm.diagnosis.engine.decision import Decision, Kind, without
from softarm.diagnosis.engine.examination import Examination
from softarm.diagnosis.engine.fits import Fit
from softarm.diagnosis.engine.fitted import FittedChoice
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.result import HeldOut, Rival, Unexplained
from softarm.diagnosis.engine.search import SelectedEffect
from softarm.diagnosis.engine.thresholds import RIG, WINDOWED
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.engine.work import Progress
from softarm.diagnosis.rigs import experiments, subsample
from softarm.diagnosis.rigs.best_fit import best_fit
from softarm.diagnosis.rigs.candidates import candidates, setup_of
from softarm.diagnosis.rigs.chain.view import ChainView
from softarm.diagnosis.rigs.driven_mass import DrivenMassView
from softarm.diagnosis.rigs.mjcf.view import JointView
from softarm.diagnosis.rigs.settling import resumed, settled
from softarm.diagnosis.rigs.subsample import Stretches
from softarm.diagnosis.rigs.tracking import TrackingView
from softarm.diagnosis.rigs.views import RigView
from softarm.schemas.verdict import (
    BestFit,
    CalibratedParameter,
    Estimate,
    Interval,
    NamedEffect,
    NextExperiment,
    Shrink,
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
# With at least this many recordings, the search holds out whole recordings instead of blocks.
TRIALS_LEAST = 4
# Names of one stage that may have a confidence; blind cases have no more faults at one stage.
RATED_MOST = 2
# A further effect within so many tolerances is none if the calibration leaves at most so many times its RMS gap. Of 17
# second names on 100 rigs, two wrong ones leave 1.0 and 1.8 times as much, right ones 3.6 times or more.
NEAR, REPLACED = 3.0, 2.5
# Repeats of a search whose budget binds.
RESTARTS_BOUND = 1
_WEAK_HELD_OUT = {
    "kind": "",
    "trial": "held-out data are other trials of the same kind of motion; record several kinds",
    "block": "held-out data are blocks of the same trial, which is the weakest test; record more trials",
}


@dataclass(frozen=True, slots=True)
class Held:
    """Effect of the whole mechanism, as all stages that it loads determined it together."""

    effect: str
    sizes: Mapping[str, Interval]  # by parameter; empty if the stages together contradict the effect
    named: NamedEffect | None = None  # the stage's entry in the verdict; None if the effect is no cause of its gap


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of the diagnosis of one stage."""

    answer: StageAnswer
    energy: float  # squared nominal residual over the squared noise floor
    regime: str
    decision: Decision
    fitted: tuple[str, ...]  # effects of the search, named or not
    named: tuple[NamedEffect, ...]
    calibration: tuple[CalibratedParameter, ...]
    best_fit: BestFit | None
    rivals: tuple[Rival, ...]
    following: NextExperiment | None
    held_out: HeldOut
    vocabulary: tuple[Effect, ...]
    whole: Mapping[str, str]  # effect of the whole mechanism that the stage can show -> the part that has it
    warnings: tuple[str, ...]
    driven_by: frozenset[str]  # stages whose measured motion loads this stage
    assumed: Mapping[str, float]  # 'effect.parameter' -> settled value of the nominal model
    noise: float = 0.0  # floor, if it is what the model leaves, in multiples of the estimate from the signals; else 0
    law: int | None = None  # number of the law that all stages together determined, if they did
    losses: tuple[float, ...] = ()  # by law: energy of the gap per sample; empty if there is one law or it was given

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

    def equal_to(self, effect: str, names: Sequence[str]) -> "Finding":
        """Return the finding with one more effect that the recordings cannot separate from some named effects."""
        other = f"{self.answer.stage}.{effect}"
        named = (
            each.model_copy(update={"equivalents": tuple(dict.fromkeys((*each.equivalents, other)))})
            if each.name in names
            else each
            for each in self.named
        )
        return replace(self, named=tuple(named))


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


def part_of(stretches: Stretches) -> RigView:
    """Return the view of some stretches of a stage's recordings."""
    view: RigView = VIEWS[stage_of(stretches.trials).kind](stretches.trials)
    return view


def examine(
    trials: Sequence[Trial],
    held: Sequence[Held] = (),
    budget_s: float = math.inf,
    report: Progress = lambda text, share: None,
    law: int | None = None,
) -> Finding:
    """Diagnose one stage from its trials; if the budget binds, the search uses the most informative stretches.

    Args:
        trials: trials of the stage.
        held: effects of the whole mechanism, which the stage's search does not change.
        budget_s: processor time, s.
        report: called with the current step and the finished share, 0 to 1.
        law: number of the nominal model's law that all stages together determined; None to choose it.
    """

    def holding(view: RigView) -> RigView:
        for each in held:
            view.hold(each.effect, each.sizes)
        return view

    whole, windows = view_of(trials)
    reduced, notes = subsample.within(budget_s, whole, windows), list[str]()
    view, used = holding(whole), windows
    if reduced is not None:
        used, note = reduced
        view, notes = holding(part_of(used)), [note]
    setup, losses = settled(view, used.kinds, used.origins, law)
    thresholds = WINDOWED if view.fits_starts and len(set(used.origins)) >= TRIALS_LEAST else RIG
    thresholds = replace(thresholds, gain=replace(thresholds.gain, ignored=view.ignored))
    search = replace(thresholds.search, refit=view.restarts_few_effects)
    if notes:  # each repeat costs as much as the search
        search = replace(search, restarts=RESTARTS_BOUND)
    thresholds = replace(thresholds, search=search)

    def examined(problem: Setup) -> Examination:
        return Examination(problem, candidates(view), thresholds, report, partial(widened, view), view.original)

    found = resumed(examined(setup), examined)
    known = [each.named for each in held if each.named is not None]
    fitted: FittedChoice = found
    sized = used
    if reduced is not None:
        sized = subsample.for_sizes(budget_s, whole, windows, found.choice.chosen.effects)
        larger = whole if sized is windows else holding(part_of(sized))
        larger.adopt(view.assumed)
        fitted = found.on(setup_of(larger, sized.kinds, sized.origins))
    affordable = len(found.search.fitted) * whole.rollout_s <= budget_s
    data = (whole, windows) if affordable else (view, used)
    finding = _Stage(found, fitted, sized.trials, known, data).finding()
    return replace(finding, warnings=(*notes, *finding.warnings), law=law, losses=losses)


def widened(view: RigView, fit: Fit, low: Array, high: Array) -> tuple[Array, Array]:
    """Return the interval of a fit's parameters with what the view cannot resolve and the uncertainty of its laws."""
    paths = [d.path.partition(".")[2] for each in fit.effects for d in each.parameters]
    u = np.array([x for us in fit.u for x in us])
    widths = view.unresolved(fit.point), view.model_uncertainty
    flat, law = (np.array([width.get(path, 0.0) for path in paths]) for width in widths)
    # The loss is flat over an unresolved range, so the fit's interval means nothing there.
    below, above = (np.where(flat > 0, np.clip(half, flat, 2 * flat), half) for half in (u - low, high - u))
    return u - np.hypot(below, law), u + np.hypot(above, law)


def squares_of(found: FittedChoice, fit: Fit, stage: str) -> Array:
    """Return the squares of a stage's gap by recording, [K], or by block if there is only one recording.

    Each block is simulated with the effects that were fitted without its fold, and without calibration.
    """
    problem, origins = found.verdict_problem, found.setup.origins
    nominal = np.zeros((len(np.unique(problem.fold)), len(problem.nuisance_low)))
    squares = held_out_squares(found.setup, found.plain, fit, nominal)[stage]
    if len(set(origins)) < 2:
        return squares
    summed = np.zeros(max(origins) + 1)
    np.add.at(summed, [origins[window] for window, _ in problem.blocks], squares)
    return summed


def estimates(found: FittedChoice, fit: Fit, name: str) -> dict[str, Estimate]:
    """Return the parameters of an effect of a fit, with their intervals, by the parameter's own name."""
    at, bounds = fit.names.index(name), found.interval(fit)
    first, sizes = sum(len(each.parameters) for each in fit.effects[:at]), {}
    for i, (parameter, u) in enumerate(zip(fit.effects[at].parameters, fit.u[at], strict=True), first):
        ends = [min(max(float(bound[i]), parameter.low), parameter.high) for bound in bounds]
        values = [parameter.value(x) for x in (u, *ends)]
        sizes[parameter.path.rpartition(".")[2]] = Estimate(
            value=values[0], low=min(values), high=max(values), unit=parameter.unit
        )
    return sizes


def is_rated(decision: Decision) -> bool:
    """Return whether the names of a stage may have a confidence.

    Next to an unexplained residual any effect may stand in for its cause; how often is not measured. The same holds for
    many names, and for those beside one that another set of as many effects replaces.
    """
    replaced = any(effect.exchangeable for effect in decision.selected)
    return decision.kind == "named" and len(decision.selected) <= RATED_MOST and not replaced


class _Stage:
    """Assembly of a stage's finding from the examination of its view."""

    def __init__(
        self,
        found: Examination,
        fitted: FittedChoice,
        trials: Sequence[Trial],
        known: Sequence[NamedEffect],
        data: tuple[RigView, Stretches],
    ) -> None:
        """Prepare the figures of a stage.

        Args:
            found: examination of the stage.
            fitted: its choice on the data of the figures.
            trials: trials of these data.
            known: named effects that the view holds.
            data: view of the recordings that a best fit predicts, and its windows.
        """
        (self.view,) = cast("tuple[RigView]", fitted.setup.views)
        self.found, self.fitted, self.trials, self.known, self.data = found, fitted, trials, known, data
        self._units = {f"{e.name}.{p.name}": p.unit for e in self.view.effects for p in e.parameters}
        self.choice, self.decision = found.choice, found.decide(None, fitted.unresolved, bool(known))
        self._predict()
        while (dropped := self._unsupported()) is not None:
            self.decision = without(self.decision, dropped)
            self._predict()
        if self.decision.selected:  # beside a large effect, the model's parameters act differently
            self.fitted = fitted.on(fitted.setup.beside(self.fit))
            self._predict()
            while (dropped := self._replaceable()) is not None:
                self.decision = without(self.decision, dropped)
                self._predict()
        if known and self.decision.kind in ("none", "unknown"):
            kind: Kind = "named" if self.decision.kind == "none" else "incomplete"
            self.decision = replace(self.decision, kind=kind, noise=False)
        self.calibrated = self._calibrated(self.fit)
        self.best_fit = self._best_fit()
        self.nominal: Array = self.view.gap([self.view.original])[0].astype(float)

    def _predict(self) -> None:
        """Predict the held-out data with the named effects, and without each of them."""
        fitted, stage = self.fitted, self.view.stage
        self.fit = fitted.named(self.decision)
        self.left_squares, self.without = squares_of(fitted, self.fit, stage), fitted.without_each(self.fit)
        self.squares_without = {name: squares_of(fitted, fit, stage) for name, fit in self.without.items()}

    def _unsupported(self) -> SelectedEffect | None:
        """Return the named effect with the smallest gain if the held-out gap is no smaller with it, calibrated or not.

        The search compares effects beside all that it has chosen. Without those that are not named, one may enlarge
        the gap. Beside a parameter that had replaced it, an effect shrinks the calibrated gap alone.
        """
        gains = {name: float(each.sum() - self.left_squares.sum()) for name, each in self.squares_without.items()}
        least = min(self.decision.selected, key=lambda effect: gains[effect.candidate.name], default=None)
        if least is None or gains[least.candidate.name] > 0:
            return None
        left, without_it = self._calibrated_gaps(least.candidate.name)
        return least if left >= without_it else None

    def _replaceable(self) -> SelectedEffect | None:
        """Return a named effect, but not the strongest, that the calibration beside the others replaces.

        In the search the model's numbers act as in the nominal model. Beside a large effect they act otherwise, and the
        rest of it may be taken for a small change of one of them.
        """
        for effect in reversed(self.decision.selected[1:]):
            name = effect.candidate.name
            u = self.fit.u[self.fit.names.index(name)]
            sizes = [(d, x) for d, x in zip(effect.candidate.parameters, u, strict=True) if not d.shape]
            if all(abs(x - d.nominal) <= NEAR * d.tolerance for d, x in sizes):
                left, without_it = self._calibrated_gaps(name)
                if without_it <= REPLACED * left:
                    return effect
        return None

    def _calibrated_gaps(self, name: str) -> tuple[float, float]:
        """Return the RMS gap that the calibration leaves beside all named effects, and beside all but one."""
        left, without_it = (self._calibrated(fit).rms[self.view.stage] for fit in (self.fit, self.without[name]))
        return left, without_it

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
            fitted=self.choice.chosen.names,
            named=(*map(self._rated, self.known), *map(self._named, decision.selected)),
            calibration=self.calibrated.parameters,
            best_fit=self.best_fit,
            rivals=rivals.by_share(found, decision),
            following=experiments.splitting(view, [self._same(m) for m in decision.selected]),
            held_out=self.fitted.setup.held_out,
            vocabulary=view.vocabulary,
            whole={effect: view.part(effect) for effect in sorted(view.whole)},
            warnings=tuple(self._warnings()),
            driven_by=view.driven_by,
            assumed=view.assumed,
            noise=self._noise() if decision.noise else 0.0,
        )

    def _unit(self, path: str) -> str:
        return self._units.get(path, PURE)

    def _calibrated(self, fit: Fit) -> Calibrated:
        """Return the calibration next to a fit; a held effect keeps the size that all stages found."""
        fitted, problem = self.fitted, self.fitted.verdict_problem
        free = np.array([path not in self.view.held for path in problem.nuisance_paths])
        problem = replace(problem, nuisance_low=problem.nuisance_low * free, nuisance_high=problem.nuisance_high * free)
        return calibrated(fitted.setup, problem, fitted.plain, fit, self._unit)

    def _best_fit(self) -> BestFit | None:
        """Return the effects that predict whole recordings best, if the named ones leave a gap and predict less."""
        if self.decision.kind not in ("incomplete", "unknown"):
            return None
        view, recordings = self.data
        if view is not self.view:
            view.adopt(self.view.assumed)
        fits = self.choice.chosen, *self.found.search.fitted
        usual = {**self.fit.point, **self.calibrated.values}
        return best_fit(view, recordings, fits, self.fit, usual, self._unit)

    def _answer(self) -> StageAnswer:
        view, found, fitted, fit = self.view, self.found, self.fitted, self.fit
        patched = view.gap([fit.point])[0].astype(float) if fit.effects or self.known else None
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
            ceiling=min(rms(fitted.residuals[view.stage].astype(float)) * math.sqrt(1 - flexible), after),
            overlays=overlays(view, self.trials, self.nominal, patched, self.calibrated.residuals.get(view.stage)),
            regimes=regimes(view, self.nominal, patched),
            unexplained=Unexplained(view.stage, self.decision.explained, tuple(features.items())),
            total_shrink=None if patched is None else self._shrink(squares_of(fitted, fitted.nominal, view.stage)),
        )

    def _floor(self) -> float:
        """Return the noise floor, RMS; without an effect, what the calibrated model leaves is noise."""
        estimated = rms(self.view.floor)
        if self.decision.kind != "none":
            return estimated
        return max(estimated, rms(self.fitted.null_residuals[self.view.stage].astype(float)))

    def _noise(self) -> float:
        """Return the noise floor in multiples of the estimate from the signals."""
        return self._floor() / rms(self.view.floor)

    def _shrink(self, before: Array) -> Interval:
        """Return the share of the held-out RMS that the named effects remove; before: squares with fewer effects."""
        return share(*shrink.interval(before, self.left_squares))

    def _rated(self, effect: NamedEffect) -> NamedEffect:
        """Return a known effect, without its confidence if the stage has a gap without a cause."""
        return effect if self.decision.kind == "named" else effect.model_copy(update={"confidence": None})

    def _named(self, effect: SelectedEffect) -> NamedEffect:
        return NamedEffect(
            name=effect.candidate.name,
            parameters=estimates(self.fitted, self.fit, effect.candidate.name),
            confidence=confidence("rig", effect) if is_rated(self.decision) else None,
            equivalents=self._same(effect)[1:],
            shrink=Shrink(stage=self._shrink(self.squares_without[effect.candidate.name])),
        )

    def _same(self, effect: SelectedEffect) -> tuple[str, ...]:
        """Return an effect and all effects that these data, or any data of such a stage, cannot separate from it."""
        names = (effect.candidate.name, *effect.equivalents)
        others = (other for name in names for other in self.view.indistinguishable.get(name, ()))
        return tuple(dict.fromkeys((*names, *others)))

    def _warnings(self) -> list[str]:
        stage, found = self.view.stage, list(self.view.warnings(self.fit.point))
        how: HeldOut = self.fitted.setup.held_out
        if self.decision.selected and _WEAK_HELD_OUT[how]:
            found.append(f"{stage}: {_WEAK_HELD_OUT[how]}")
        found += rivals.not_named(self.choice, self.decision)
        found += rivals.not_rated(self.decision)
        if self.best_fit is not None:
            left = 100 * self.best_fit.after.value / self.best_fit.before.value
            effects = ", ".join(dict.fromkeys(path.split(".")[1] for path in self.best_fit.parameters))
            found.append(
                f"{stage}: the best fit ({effects}) leaves {left:.0f} % of the gap of whole recordings, held out; a "
                "model, no diagnosis: --patch FILE --best-fit writes it"
            )
        if self.decision.structure and (self.decision.selected or self.found.slow):
            found.append(f"{stage}: the residual is not noise ({'; '.join(self.decision.structure.values())})")
        if self.decision.noise:
            found.append(
                f"{stage}: the noise floor is what the model leaves, {self._noise():.2g} times the estimate from the "
                "signals; a flexible model explains nothing of it beyond chance on held-out data"
            )
        damping = self.fitted.setup.fitted_nuisances(self.fit).get(f"{stage}.damping.scale")
        if damping is not None and self.decision.selected and damping < -0.9:
            found.append(
                f"{stage}: with the named effects, the model's viscous friction vanishes "
                f"(damping x {max(1 + damping, 0.0):.2g}); it had replaced them"
            )
        return found
