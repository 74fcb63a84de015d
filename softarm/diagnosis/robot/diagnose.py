"""Diagnosis of the robot: from trials and a nominal model to the answer."""

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from softarm.diagnosis.answer import rivals
from softarm.diagnosis.answer.assembly import StageAnswer, assemble, gap_of, share
from softarm.diagnosis.answer.evidence import overlays, regimes, spectrum
from softarm.diagnosis.data.trials import Trial
from softarm.diagnosis.engine.candidates import FittedParameter, split
from softarm.diagnosis.engine.confidence import confidence, margins
from softarm.diagnosis.engine.decision import Decision, Kind, stage_of, stage_shares
from softarm.diagnosis.engine.examination import Examination
from softarm.diagnosis.engine.result import Diagnosis, Unexplained
from softarm.diagnosis.engine.search import Choice
from softarm.diagnosis.engine.shrink import widened
from softarm.diagnosis.engine.thresholds import NEXT_TO_ANOTHER, ROBOT
from softarm.diagnosis.engine.view import Point
from softarm.diagnosis.engine.work import Progress
from softarm.diagnosis.robot import experiments
from softarm.diagnosis.robot.candidates import candidates
from softarm.diagnosis.robot.comparison import Comparison, compare, effect_shrink, held_out_tip_gap, stage_gap
from softarm.diagnosis.robot.counts import Count, counts
from softarm.diagnosis.robot.decided import REGIME_S, Decided, calibrated_tip, decide, largest_regime, with_calibration
from softarm.diagnosis.robot.drive import SERVO
from softarm.diagnosis.robot.trial_grid import RATE_HZ
from softarm.schemas.model import Model
from softarm.schemas.verdict import Estimate, Interval, NamedEffect, NextExperiment, Shrink, Verdict, Where
from softarm.simulator.effects import REGISTRY, STAGES, find

ALWAYS_SHOWN = ("clock", "observation")  # counted stages that are listed without a named effect as well
KINDS_LEAST = 3  # kinds of excitation
OTHERS_MAX = 3  # explanations that one experiment separates from the named one
# Share of a tolerance that 95 of 100 well-kept robots stay within, measured on robots with one known cause each.
TOLERANCE_95 = 0.6
AT_BOUND_MIN = 50.0  # gain of an effect at its bound that is worth a warning


def diagnose_robot(trials: Sequence[Trial], nominal: Model, progress: Progress) -> Diagnosis:
    """Return the diagnosis of the robot's trials by a nominal model; raise TrialError if no stage can be compared."""
    started = time.monotonic()
    comparison = compare(trials, nominal, progress)
    counted = counts(comparison.trials, comparison.model)
    named = [count for count in counted if count.named]
    found = Examination(
        comparison.setup,
        candidates(comparison.model, comparison.stages),
        NEXT_TO_ANOTHER if named else ROBOT,
        lambda what, done: progress(what, 0.12 + 0.78 * done),
    )
    progress("fitting a flexible model", 0.90)
    decided = decide(comparison, found)
    progress("measuring the shrink of the gap", 0.96)
    stages = _stages(comparison, found, decided, counted)
    patched = None
    if decided.decision.selected or named:
        patched = _patched(comparison.model, decided, named)
    whole = patched
    if decided.calibrated.values:
        whole = with_calibration(patched or comparison.model, decided.calibrated.values)
    return replace(
        assemble(_verdict(comparison, found, decided, named, stages), stages, comparison.trials, started),
        nominal=nominal,
        patched=patched,
        calibrated=whole,
        rivals=rivals.by_gain(found.search, found.choice, decided.decision),
        held_out=comparison.setup.held_out,
        margins=margins(decided.decision.selected),
    )


def _verdict(
    comparison: Comparison, found: Examination, decided: Decided, named: Sequence[Count], stages: Sequence[StageAnswer]
) -> Verdict:
    decision = decided.decision
    energies: dict[str, float] = {}
    for count in named:
        energies[count.stage] = energies.get(count.stage, 0.0) + (count.before / count.floor) ** 2
    shares = stage_shares(decision, energies)
    kind: Kind = decision.kind
    if named:
        kind = "named" if kind in ("none", "named") else "incomplete"
    stage = None if kind == "none" else stage_of(shares, STAGES)
    effects = _named_effects(comparison, found, decided) + [_count_effect(count) for count in named]
    return Verdict(
        verdict=kind,
        where=Where(stage=stage, share=shares, regime=_regime(comparison, found, stage)),
        effects=tuple(sorted(effects, key=lambda e: -shares.get(e.name.partition(".")[0], 0.0))),
        equal_sets=decision.equal_sets,
        calibration=decided.calibrated.parameters,
        gap=gap_of(stages),
        next_experiment=_next(comparison, found, decision),
        warnings=tuple(dict.fromkeys(_warnings(comparison, found.choice, decision))),
    )


def _regime(comparison: Comparison, found: Examination, stage: str | None) -> str:
    if stage is None:
        return "nowhere"
    if stage in found.slow:
        return found.slow[stage].where
    for view, gaps in zip(comparison.views, comparison.setup.gaps, strict=True):
        if view.stage == stage:
            return largest_regime(view, gaps.fetch([{}])[()])
    return "throughout"


def _named_effects(comparison: Comparison, found: Examination, decided: Decided) -> list[NamedEffect]:
    fit, without = decided.fit, found.without_each(decided.fit)
    lows, highs = (split(fit.effects, end) for end in found.interval(fit))
    effects = []
    for effect in decided.decision.selected:
        name = effect.candidate.name
        i, parameters = fit.names.index(name), {}
        for parameter, *size in zip(effect.candidate.parameters, fit.u[i], lows[i], highs[i], strict=True):
            value = fit.point[parameter.path]
            ends = _with_tolerance(parameter, *size)
            if np.isfinite(value):
                finite = [x if np.isfinite(x) else find(parameter.path)[1].high for x in (value, *ends)]
                estimate = Estimate(value=value, low=min(finite), high=max(finite), unit=parameter.unit)
                parameters[parameter.path.rpartition(".")[2]] = estimate
        effects.append(
            NamedEffect(
                name=name,
                parameters=parameters,
                # In an incomplete answer an effect may stand in for the unknown cause of the rest.
                confidence=confidence("robot", effect) if decided.decision.kind == "named" else None,
                equivalents=effect.equivalents,
                shrink=effect_shrink(comparison, found.plain, effect, without[name], decided.fit),
            )
        )
    return effects


def _with_tolerance(parameter: FittedParameter, u: float, low: float, high: float) -> tuple[float, float]:
    """Return the ends of a size's interval, in the registry's unit, widened by most of the parameter's tolerance.

    Noise alone gives a hundredth of the size. A well-kept robot shows up to the tolerance, and that much of the fitted
    size may be the robot's own instead of its fault's. Where noise excludes the model's own value, the interval ends
    there: the effect is present, only its size is uncertain.
    """
    own = TOLERANCE_95 * parameter.tolerance
    below, above = math.hypot(u - low, own), math.hypot(high - u, own)
    first, last = u - below, u + above
    if low > parameter.nominal:
        first = max(first, parameter.nominal)
    if high < parameter.nominal:
        last = min(last, parameter.nominal)
    return parameter.value(first), parameter.value(last)


def _count_effect(count: Count) -> NamedEffect:
    estimate = Estimate(value=count.value, low=count.low, high=count.high, unit=count.unit)
    parameters = {count.parameter: estimate} if count.parameter else {}
    return NamedEffect(name=count.name, parameters=parameters, shrink=Shrink(stage=_count_shrink(count)))


def _count_shrink(count: Count) -> Interval:
    spread = (count.high - count.low) / max(2 * abs(count.value - count.nominal), 1e-12) if count.parameter else 0.1
    return share(count.shrink, *widened(count.shrink, count.shrink - spread, count.shrink + spread))


def _stages(
    comparison: Comparison, found: Examination, decided: Decided, counted: Sequence[Count]
) -> list[StageAnswer]:
    """Return the gaps of all stages, of effects measured from stamps and noise, and of the whole chain."""
    point, points = decided.fit.point, decided.fit.fold_points
    answers, calibrated = [], decided.calibrated
    for view, gaps in zip(comparison.views, comparison.setup.gaps, strict=True):
        gap = stage_gap(comparison, view, gaps, points)
        fetched = gaps.fetch([{}, point])
        before, after = fetched[()], fetched[gaps.key(point)] if point else None
        flexible, features = found.flexible.get(view.stage, (0.0, None))
        explained = decided.decision.explained
        shown = None if len(view.channels) <= 2 else (len(view.channels) // 2 - 1, len(view.channels) - 1)
        answers.append(
            StageAnswer(
                stage=view.stage,
                unit=view.unit,
                before=gap.before,
                after=gap.after,
                floor=decided.floors[view.stage],
                calibrated=calibrated.rms[view.stage],
                ceiling=gap.after * float(np.sqrt(1 - flexible)),
                overlays=overlays(view, comparison.trials, before, after, calibrated.residuals.get(view.stage), shown),
                spectrum=spectrum(view, before, after, RATE_HZ),
                regimes=regimes(view, before, after, REGIME_S),
                unexplained=None if features is None else Unexplained(view.stage, explained, tuple(features.items())),
                total_shrink=gap.total_shrink if point else None,
            )
        )
    answers += _counted_stages(counted, {each.stage for each in answers})
    tip = held_out_tip_gap(comparison, points)
    if tip is not None and decided.chain_floor is not None:
        left = calibrated_tip(comparison, calibrated, points)
        total = tip.total_shrink if point else None
        answers.append(
            StageAnswer("chain", "m", tip.before, tip.after, decided.chain_floor, left, None, total_shrink=total)
        )
    return answers


def _counted_stages(counted: Sequence[Count], known: set[str]) -> list[StageAnswer]:
    answers: dict[str, StageAnswer] = {}
    for count in sorted(counted, key=lambda count: not count.named):
        if count.stage not in known and count.stage not in answers and (count.named or count.stage in ALWAYS_SHOWN):
            before, floor = round(count.before, 9), round(count.floor, 9)
            after = round(count.after if count.named else count.before, 9)
            total = _count_shrink(count) if count.named else None
            answers[count.stage] = StageAnswer(
                count.stage, count.unit, before, after, floor, None, after, total_shrink=total
            )
    return list(answers.values())


def _next(comparison: Comparison, found: Examination, decision: Decision) -> NextExperiment | None:
    """Return a flight that separates a set, a note that none does, or a repeat of the worst trial."""
    asked = None
    for explanations in _explanations(found, decision):
        plan = experiments.splitting(comparison.model, explanations, found.plain, comparison.setup.kinds)
        if plan.expect:
            return plan
        asked = asked or plan
    if asked is None and decision.kind in ("unknown", "incomplete"):
        return experiments.repeated(_worst_kind(comparison, found))
    return asked


def _explanations(found: Examination, decision: Decision) -> Iterator[dict[str, Point]]:
    """Yield groups of explanations that fit equally well, each with its fitted parameters."""
    chosen = found.choice.chosen
    for effect in decision.selected:
        if close := [fit for fit, _ in effect.rivals if fit.effects[-1].name in effect.equivalents]:
            yield {effect.candidate.name: chosen.point} | {
                fit.effects[-1].name: fit.point for fit in close[:OTHERS_MAX]
            }
    if decision.equal_sets:
        fits = (chosen, *found.choice.equal_sets[:OTHERS_MAX])
        yield {" with ".join(fit.names): fit.point for fit in fits}


def _worst_kind(comparison: Comparison, found: Examination) -> str:
    """Return the excitation of the trial with the largest gap, in the stage with the largest residual."""
    after = found.choice.energies[1]
    pairs = zip(comparison.views, found.plain.whitened, strict=True)
    view, residual = max(pairs, key=lambda pair: after[pair[0].stage])
    rows = residual.moments([{}])[0].rows.reshape(len(view.trial), -1)
    squares = [
        float((rows[view.trial == k] ** 2).mean()) if (view.trial == k).any() else 0.0
        for k in range(len(comparison.trials))
    ]
    return comparison.trials[int(np.argmax(squares))].kind


def _warnings(comparison: Comparison, choice: Choice, decision: Decision) -> list[str]:
    found = [warning for trial in comparison.trials for warning in trial.warnings]
    if comparison.model is not comparison.nominal:
        found.append(f"the drive behaves like a servo, and the model has none: {SERVO} is added to both models")
    for trial in comparison.trials:
        found += [f"{trial.name}: {text}" for text in trial.not_observable.values()]
    if len(set(comparison.setup.kinds)) < KINDS_LEAST:
        found.append(
            "fewer than three kinds of excitation: wrong effects may fit as well; record more (softarm excite)"
        )
    found += [f"{stage}: {where}; no known effect explains it" for stage, where in decision.structure.items()]
    found += [*rivals.not_named(choice, decision), *rivals.not_rated(decision)]
    for fit, gain in choice.alone[:3]:
        if fit.at_bound and gain.value > AT_BOUND_MIN:
            found.append(f"{fit.names[0]} is not named: it explains part of the gap only at the end of its range")
    return found


def _patched(model: Model, decided: Decided, named: Sequence[Count]) -> Model:
    """Return the nominal model with the named effects, without an effect that the robot does not have."""
    effects = {name: dict(values) for name, values in model.effects.items()}
    point = decided.fit.point
    for name in decided.fit.names:
        values = {p.name: point[f"{name}.{p.name}"] for p in REGISTRY[name].parameters}
        if all(values[p.name] == p.neutral for p in REGISTRY[name].parameters if p.default is None):
            effects.pop(name, None)
        else:
            effects[name] = values
    for count in named:
        if count.parameter:
            effects.setdefault(count.name, {})[count.parameter] = count.value
        elif count.present:
            effects[count.name] = {}
        else:
            effects.pop(count.name, None)
    return model.model_copy(update={"effects": effects})
