"""A single-stage table to a diagnosis: which effects each of its stages has beyond the nominal model."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from softarm.common import resample
from softarm.diagnosis.data.trials import Trial, TrialError
from softarm.diagnosis.engine.fits import Fit, FitProblem
from softarm.diagnosis.engine.problem import Setup, held_out_by
from softarm.diagnosis.engine.result import Diagnosis, HeldOut, Leftover, Overlay, Regime, Rival
from softarm.diagnosis.engine.search import Gain, Progress, SelectedEffect
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.engine.whitened import BLOCK_S, blocks_of
from softarm.diagnosis.rigs.candidates import candidates, nuisances
from softarm.diagnosis.rigs.ceiling import ceiling
from softarm.diagnosis.rigs.driven_mass import DrivenMassView
from softarm.diagnosis.rigs.pendulum import PendulumView
from softarm.diagnosis.rigs.selection import Backward, Refitted
from softarm.diagnosis.rigs.tracking import TrackingView, velocity_warnings
from softarm.diagnosis.rigs.views import RigView
from softarm.schemas.verdict import Estimate, Gap, Interval, NamedEffect, Quantity, Shrink, Verdict, Where


class ViewClass(Protocol):
    """What a kind of stage brings: `RigView`s made of trials, and how a trial is cut before that."""

    def __call__(self, trials: Sequence[Trial], /) -> RigView:
        """The view; raises TrialError for what it cannot be made of."""

    def shots(self, trial: Trial, /) -> tuple[Trial, ...]:
        """See RigView."""


# A new kind of stage is a line here.
VIEWS: Mapping[str, ViewClass] = {"tracking": TrackingView, "driven_mass": DrivenMassView, "pendulum": PendulumView}

NULL_FLOORS = 2.0  # a gap below this many floors is none
NAMED_SHARE, INCOMPLETE_SHARE = 0.8, 0.3  # of what any model could explain
FOLDS_LEAST, FOLDS_MOST = 4, 6  # of whole trials
FOLDS = 5  # of blocks
_CONFIDENCE_NOTE = (
    "the confidences of a table are of its own blocks, drawn anew; no cases of known cause stand behind them"
)


@dataclass(frozen=True, slots=True)
class StageFinding:
    """What was found of one stage."""

    view: RigView
    trials: tuple[Trial, ...]  # in the view's order
    null_model: Fit
    chosen: Fit
    selected: tuple[SelectedEffect, ...]
    without: Mapping[str, Fit]  # the chosen without each of its effects
    alone: tuple[tuple[Fit, Gain], ...]
    further: tuple[tuple[Fit, Gain], ...]  # the chosen with one more
    nominal: Array  # [M, S] residuals
    left: Array
    ceiling: float  # RMS
    leans: tuple[tuple[str, float], ...]
    nuisances: Mapping[str, float]  # fitted beside the chosen
    bounds: tuple[Array, Array]  # 95 % interval of the chosen's parameters, low and high
    held_out: HeldOut

    @property
    def before(self) -> float:
        """RMS of the nominal gap."""
        return _rms(self.nominal)

    @property
    def after(self) -> float:
        """RMS of the patched gap, held out: the in-sample one, larger as the held-out loss is."""
        spoiled = self.chosen.held_out.sum() / max(self.chosen.loss, 1e-12)
        return min(_rms(self.left) * math.sqrt(max(spoiled, 1.0)), self.before)


def diagnose_table(trials: Sequence[Trial], tell: Progress = lambda text, share: None) -> Diagnosis:
    """Diagnose every stage of a table's trials, each alone; deterministic.

    tell: what is being done, and how far it is (0 to 1). Raises TrialError for trials of no table, and for kinds that
    have no view yet.
    """
    started = time.monotonic()
    names = sorted({t.stage.name for t in trials if t.stage is not None})
    if not names or any(t.stage is None for t in trials):
        raise TrialError("these trials are of no single-stage table; diagnose recordings of the robot by their own way")
    stages = []
    for i, name in enumerate(names):
        tell(name, i / len(names))
        stages.append(_stage([t for t in trials if t.stage is not None and t.stage.name == name]))
    tracking = [t for t in trials if t.stage is not None and t.stage.kind == "tracking"]
    warnings = [*dict.fromkeys(w for t in trials for w in t.warnings), *velocity_warnings(tracking)]
    warnings += [text for stage in stages for text in stage.view.warnings]
    warnings += [text for stage in stages for text in _notes(stage)]
    return Diagnosis(
        verdict=_verdict(stages, warnings),
        nominal=None,
        patched=None,
        trials=tuple((t.name, t.kind, t.duration_s) for t in trials),
        overlays=tuple(overlay for stage in stages for overlay in _overlays(stage)),
        regimes=tuple(regime for stage in stages for regime in _regimes(stage)),
        rivals=tuple(rival for stage in stages for rival in _rivals(stage)),
        leftovers=tuple(Leftover(s.view.stage, _explained(s), s.leans) for s in stages),
        nuisances={path: value for s in stages for path, value in s.nuisances.items()},
        units={f"{e.name}.{p.name}": p.unit for s in stages for e in s.view.effects for p in e.parameters},
        seconds=time.monotonic() - started,
        together={s.view.stage: _together(s) for s in stages if s.selected},
        held_out=min((s.held_out for s in stages), key=("block", "trial", "kind").index),
        vocabulary={effect.name: effect for s in stages for effect in s.view.effects},
    )


def view_of(trials: Sequence[Trial]) -> tuple[RigView, tuple[Trial, ...], NDArray[np.int64]]:
    """A stage's view, its trials in the view's order, and the fold [M] that every sample is left out with."""
    kind = trials[0].stage.kind if trials[0].stage is not None else ""
    if kind not in VIEWS:
        raise TrialError(f"{trials[0].source}: a {kind} stage cannot be diagnosed yet; {' and '.join(VIEWS)} can")
    cut = [(k, shot) for k, trial in enumerate(trials) for shot in VIEWS[kind].shots(trial)]
    shots = tuple(shot for _, shot in cut)
    view = VIEWS[kind](shots)
    if not view.fits_starts or len(trials) < FOLDS_LEAST:
        return view, shots, stretches(view)
    group = np.array([k * min(FOLDS_MOST, len(trials)) // len(trials) for k, _ in cut])  # neighbours: alike
    return view, shots, group[view.trial]


def stretches(view: RigView) -> NDArray[np.int64]:
    """[M] folds that leave out every fifth block of each trial.

    Not a kind of excitation a fold: what only the fast end of one sweep shows (an end of the torque) would be
    extrapolated from the others, and the loss there would say nothing of the rest.
    """
    fold = np.empty(len(view.t_s), dtype=np.int64)
    for (trial, number), a, b in blocks_of(view, BLOCK_S):
        fold[a:b] = (trial + number) % FOLDS
    return fold


def _stage(trials: Sequence[Trial]) -> StageFinding:
    view, ordered, fold = view_of(trials)
    setup = Setup([view], nuisances(view), [t.kind for t in ordered])
    plain, problem = setup.plain(), setup.weighed()
    problem = replace(problem, fold=np.array([fold[a] for _, a, _ in blocks_of(view, BLOCK_S)]))
    search = Backward(
        Refitted(*(getattr(problem, f.name) for f in fields(FitProblem))), plain, [view.stage], candidates(view)
    )
    null_model = search.problem.fit([((), ())])[0]
    chosen = (
        search.chosen(search.full(null_model), null_model)
        if _floors(view.gap([{}])[0], view) > NULL_FLOORS
        else null_model
    )
    selected = search.selected(chosen, null_model) if chosen.effects else ()
    spared = search.reduced(chosen) if len(chosen.effects) > 1 else [null_model] * len(chosen.effects)
    without = dict(zip(chosen.names, spared, strict=True))
    alone = tuple((f, search.gain(null_model, f)) for f in search.extended(null_model))
    further = tuple((f, search.gain(chosen, f)) for f in search.extended(chosen)) if chosen.effects else ()
    left = setup.residuals(plain, chosen)[0].astype(float)
    lowest, leans = ceiling(left, view.features, fold)
    nominal = view.gap([{}])[0].astype(float)
    return StageFinding(
        view,
        ordered,
        null_model,
        chosen,
        selected,
        without,
        alone,
        further,
        nominal,
        left,
        _rms(lowest[None]),
        leans,
        setup.fitted_nuisances(chosen),
        search.problem.interval(chosen),
        held_out_by(problem.blocks, problem.fold, [t.kind for t in ordered]),
    )


def _verdict(stages: Sequence[StageFinding], warnings: Sequence[str]) -> Verdict:
    energy = {s.view.stage: (s.before / float(s.view.floor.mean())) ** 2 for s in stages}
    total = sum(energy.values())
    gaps = [s for s in stages if _floors(s.nominal, s.view) > NULL_FLOORS]
    named = [s for s in gaps if s.selected]
    answer: Literal["named", "incomplete", "unknown", "none"]
    if not gaps:
        answer = "none"
    elif not named or max(_explained(s) for s in named) < INCOMPLETE_SHARE:
        answer = "unknown"
    else:
        answer = "named" if min(_explained(s) for s in gaps) >= NAMED_SHARE else "incomplete"
    where = max(gaps, key=lambda s: energy[s.view.stage]) if gaps else None
    quantity = {s.view.stage: s.view.unit for s in stages}

    def each(value: Callable[[StageFinding], float]) -> dict[str, Quantity]:
        return {s.view.stage: Quantity(value=value(s), unit=quantity[s.view.stage]) for s in stages}

    return Verdict(
        verdict=answer,
        where=Where(
            stage=where.view.stage if where else None,
            share={name: value / total if total else 0.0 for name, value in energy.items()},
            regime=_worst_regime(where) if where else "nowhere: the gap is within the floor",
        ),
        effects=tuple(_named(s, m) for s in stages for m in s.selected),
        gap=Gap(
            before=each(lambda s: s.before),
            after=each(lambda s: s.after),
            floor=each(lambda s: float(np.sqrt(np.mean(s.view.floor**2)))),
            ceiling=each(lambda s: min(s.ceiling, s.after)),
        ),
        warnings=(*warnings, *([_CONFIDENCE_NOTE] if named else [])),
    )


def _named(stage: StageFinding, effect: SelectedEffect) -> NamedEffect:
    at = [each.name for each in stage.chosen.effects].index(effect.candidate.name)
    first = sum(len(each.parameters) for each in stage.chosen.effects[:at])
    estimates = {}
    for i, (parameter, u) in enumerate(zip(effect.candidate.parameters, stage.chosen.u[at], strict=True)):
        low, high = (min(max(float(x[first + i]), parameter.low), parameter.high) for x in stage.bounds)
        low, high = (low, high) if not parameter.inverse else (high, low)
        finite = [
            v if math.isfinite(v) else 1e12 for v in (parameter.value(low), parameter.value(u), parameter.value(high))
        ]
        name = parameter.path.rpartition(".")[2]
        estimates[name] = Estimate(value=finite[1], low=min(finite), high=max(finite), unit=parameter.unit)
    rivals = [g for f, g in effect.rivals if f.effects[-1].name not in effect.equivalents and not f.at_bound]
    same = (*effect.equivalents, *stage.view.twins.get(effect.candidate.name, ()))
    sure = _odds(effect.gain) * min((_odds(g) for g in rivals), default=1.0) / (1 + len(same))
    less = stage.without[effect.candidate.name]
    return NamedEffect(
        name=effect.candidate.name,
        parameters=estimates,
        confidence=min(sure, 0.99),
        equivalents=same,
        shrink=Shrink(stage=_shrink(less.held_out, stage.chosen.held_out)),
    )


def _odds(gain: Gain) -> float:
    """Probability that a gain is above zero, as its interval says."""
    sigma = max((gain.high - gain.low) / 3.92, 1e-9)
    return 0.5 * (1 + math.erf(gain.value / sigma / math.sqrt(2)))


def _shrink(less: Array, more: Array) -> Interval:
    """Share of the RMS that goes, with its 95 % interval over blocks drawn anew."""
    drawn = resample.draws(len(less))
    low, high = resample.interval(1 - np.sqrt(np.maximum(drawn @ more, 0.0) / np.maximum(drawn @ less, 1e-12)))
    value = 1 - math.sqrt(max(float(more.sum()), 0.0) / max(float(less.sum()), 1e-12))
    return Interval(value=value, low=min(float(low), value), high=max(float(high), value))


def _together(stage: StageFinding) -> Interval:
    """Share of the RMS in `before` that is gone in `after`, with its 95 % interval over blocks drawn anew."""
    blocks = [slice(a, b) for _, a, b in blocks_of(stage.view, BLOCK_S)]
    before, left = (np.array([np.nansum(gap[b] ** 2) for b in blocks]) for gap in (stage.nominal, stage.left))
    after = left * (stage.after / max(_rms(stage.left), 1e-12)) ** 2
    return _shrink(before, after)


def _explained(stage: StageFinding) -> float:
    """Share of what any model could explain that the named effects do."""
    could = stage.before**2 - min(stage.ceiling, stage.after) ** 2
    return min(max((stage.before**2 - stage.after**2) / could, 0.0), 1.0) if could > 0 else 1.0


def _rivals(stage: StageFinding) -> list[Rival]:
    alone = {f.effects[0].name: f for f, _ in stage.alone}
    further = {f.effects[-1].name: f for f, _ in stage.further}
    selected = {m.candidate.name: m for m in stage.selected}
    found = []
    for name, fit in alone.items():
        share = min(max(_shrink(stage.null_model.held_out, fit.held_out).value, 0.0), 1.0)
        if name in selected:
            conditional, note, parameters = (
                _shrink(stage.without[name].held_out, stage.chosen.held_out),
                "named",
                stage.chosen.point,
            )
            parameters = {k: v for k, v in parameters.items() if k.startswith(f"{name}.")}
        else:
            more = further.get(name, fit)
            conditional = _shrink((stage.chosen if name in further else stage.null_model).held_out, more.held_out)
            parameters = {k: v for k, v in more.point.items() if k.startswith(f"{name}.")}
            stands_in = [m.candidate.name for m in stage.selected if name in m.equivalents]
            note = f"cannot be told from {stands_in[0]}" if stands_in else ("at its bound" if more.at_bound else "")
        found.append(Rival((name,), share, conditional, parameters, note))
    return sorted(found, key=lambda r: (-r.alone, r.names))


def _overlays(stage: StageFinding) -> list[Overlay]:
    view, found = stage.view, []
    for k, trial in enumerate(stage.trials):
        mine = view.trial == k
        for s, channel in enumerate(view.channels):
            seen, left = view.measured[mine, s], stage.left[mine, s]
            patched = seen - left if stage.chosen.effects else None
            nominal = seen - stage.nominal[mine, s]
            found.append(
                Overlay(view.stage, trial.name, trial.kind, channel, view.unit, view.t_s[mine], seen, nominal, patched)
            )
    return found


def _regimes(stage: StageFinding) -> list[Regime]:
    named = bool(stage.chosen.effects)
    return [
        Regime(
            stage.view.stage,
            name,
            int(mask.sum()),
            _rms(stage.nominal[mask]),
            _rms(stage.left[mask]) if named else None,
            stage.view.unit,
        )
        for name, mask in stage.view.regimes.items()
        if np.isfinite(stage.nominal[mask]).any()
    ]


def _worst_regime(stage: StageFinding) -> str:
    found = max(_regimes(stage), key=lambda r: r.nominal_rms, default=None)
    return "everywhere" if found is None else f"most where: {found.name}"


def _notes(stage: StageFinding) -> list[str]:
    """What a fit beside the named effects says of the model itself."""
    damping = stage.nuisances.get(f"{stage.view.stage}.damping.scale")
    if damping is None or not stage.selected or damping > -0.9:
        return []
    return [
        f"{stage.view.stage}: beside the named effects nothing is left of the model's viscous friction "
        f"(damping x {max(1 + damping, 0.0):.2g}): it stood in for them"
    ]


def _floors(gap: Array, view: RigView) -> float:
    """RMS in floors, of the worst channel."""
    return float(np.max(np.sqrt(np.nanmean(np.asarray(gap, dtype=float) ** 2, axis=0)) / view.floor))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(values**2)))
