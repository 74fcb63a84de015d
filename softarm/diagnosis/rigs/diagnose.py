"""Diagnosis of the trials of one rig: each stage on its own, then the effects that stages share."""

import math
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from softarm.common.processes import as_they_come
from softarm.diagnosis.answer.assembly import StageAnswer, assemble, gap_of
from softarm.diagnosis.data.trials import Trial, TrialError, stage_of
from softarm.diagnosis.engine.confidence import margins
from softarm.diagnosis.engine.decision import Kind
from softarm.diagnosis.engine.result import Diagnosis
from softarm.diagnosis.engine.work import Progress
from softarm.diagnosis.rigs.mjcf.film import film
from softarm.diagnosis.rigs.mjcf.simulation import CREEP
from softarm.diagnosis.rigs.settling import common_law, is_other_law
from softarm.diagnosis.rigs.stage import VIEWS, Finding, Held, examine, is_rated
from softarm.diagnosis.rigs.whole import judged
from softarm.schemas.verdict import Verdict, Where

# Shares of a stage's time at which its search begins and ends.
BEGUN, SEARCHED = 0.05, 0.9
# Share of the time in which every stage is diagnosed on its own, if stages may share an effect of the whole mechanism.
FIRST = 0.7
# Share at which the stages are diagnosed that a simulation's law changes, if there are any.
LAW = 0.85
# Trials of a stage, effects that it holds, and the number of its law if all stages determined it.
_Job = tuple[Sequence[Trial], Sequence[Held], int | None]


def diagnose_table(
    trials: Sequence[Trial],
    report: Progress = lambda text, share: None,
    processes: int = 1,
    budget_s: float = math.inf,
) -> Diagnosis:
    """Diagnose every stage of a rig's trials, and effects that stages share; the result is deterministic.

    Args:
        trials: trials read from a stage.yaml.
        report: called with the current step and the finished share, 0 to 1.
        processes: number of stages diagnosed at the same time.
        budget_s: processor time for all stages, s, each on its own; of longer recordings only stretches are used. An
            effect that stages share takes about as much again.

    Raises:
        TrialError: if a trial lacks a column, or its model a value, or two models have stages with one name.
    """
    started = time.monotonic()
    refuse_two_models(trials)
    own: dict[str, list[Trial]] = {}
    for trial in trials:
        own.setdefault(stage_of([trial]).name, []).append(trial)
    found = _alone(own, budget_s / len(own), report, processes)
    _with_one_law(own, found, budget_s / len(own), report, processes)
    joint = _joint(own, found, budget_s / len(own), report, processes)
    stages = [found[name].rated(found) for name in sorted(own)]
    warnings = [*dict.fromkeys(w for t in trials for w in t.warnings)]
    warnings += [text for stage in stages for text in stage.warnings]
    warnings += joint
    answers = [stage.answer for stage in stages]
    assembled = assemble(_verdict(stages, answers, warnings), answers, trials, started)
    return replace(
        assembled,
        film=film(assembled, trials),
        rivals=tuple(rival for s in stages for rival in s.rivals),
        margins={name: x for s in stages if is_rated(s.decision) for name, x in margins(s.decision.selected).items()},
        noise={s.answer.stage: s.noise for s in stages if s.noise},
        held_out=min((s.held_out for s in stages), key=("block", "trial", "kind").index),
        units={f"{e.name}.{p.name}": p.unit for s in stages for e in s.vocabulary for p in e.parameters},
        vocabulary={effect.name: effect for s in stages for effect in s.vocabulary},
    )


def refuse_two_models(trials: Iterable[Trial]) -> None:
    """Raise TrialError if stages with one name have different nominal models; copies of an MJCF file are one."""
    first: dict[str, Trial] = {}
    for trial in trials:
        stage, other = stage_of([trial]), first.setdefault(stage_of([trial]).name, trial)
        own, model = ({"kind": each.kind, **each.model, "effects": each.effects} for each in (stage, stage_of([other])))
        differing = [key for key in {**model, **own} if model.get(key) != own.get(key)]
        if "mjcf" in differing and len({Path(str(each["mjcf"])).read_bytes() for each in (own, model)}) == 1:
            differing.remove("mjcf")
        if differing:
            key = differing[0]
            remedy = "rename the joint in one model" if stage.kind == "mujoco" else "give one another `name`"
            raise TrialError(
                f"{other.source} and {trial.source}: both record a stage {stage.name}, but {key} of the nominal model "
                f"is {model.get(key)} and {own.get(key)}; allowed is one model for each name; {remedy}, or describe "
                "and diagnose each alone"
            )


def _alone(own: Mapping[str, Sequence[Trial]], budget_s: float, report: Progress, processes: int) -> dict[str, Finding]:
    """Return the finding of each stage on its own."""
    names, found = sorted(own), dict[str, Finding]()
    report(names[0], 0.0)
    first = FIRST if len(names) > 1 and VIEWS[stage_of(own[names[0]]).kind].whole else 1.0
    work = partial(examine, budget_s=budget_s)
    if processes == 1 or len(names) == 1:  # another process cannot report its steps

        def within(text: str, share: float) -> None:
            report(text, first * (len(found) + BEGUN + (SEARCHED - BEGUN) * share) / len(names))

        work = partial(work, report=within)
    for _, finding in as_they_come(work, [own[name] for name in names], processes):
        found[finding.answer.stage] = finding
        report(finding.answer.stage, first * len(found) / len(names))
    return found


def _with_one_law(
    own: Mapping[str, Sequence[Trial]],
    found: dict[str, Finding],
    budget_s: float,
    report: Progress,
    processes: int,
) -> None:
    """Diagnose the stages again that chose another law of the nominal model than all of them together show.

    A stage without a cause is left as it is if it has no gap with that law.
    """
    law = common_law([finding.losses for finding in found.values()])
    if law is None:
        return
    other = [
        stage
        for stage, finding in found.items()
        if is_other_law(finding.losses, law, has_cause=finding.decision.kind != "none")
    ]
    jobs: list[_Job] = [(own[stage], (), law) for stage in other]
    for share, finding in _again(jobs, budget_s, processes):
        found[finding.answer.stage] = finding
        report(f"{finding.answer.stage}, as simulated", FIRST + (LAW - FIRST) * share)


def _joint(
    own: Mapping[str, Sequence[Trial]],
    found: dict[str, Finding],
    budget_s: float,
    report: Progress,
    processes: int,
) -> list[str]:
    """Diagnose the stages again that share an effect of the whole mechanism, and return what a reader needs to know."""
    judgements, held = list(judged(own, found, budget_s)), dict[str, list[Held]]()
    for judgement in judgements:
        for stage, each in judgement.held.items():
            held.setdefault(stage, []).append(each)
    begun = LAW if any(finding.law is not None for finding in found.values()) else FIRST
    jobs: list[_Job] = [(own[stage], each, found[stage].law) for stage, each in held.items()]
    for share, finding in _again(jobs, budget_s, processes):
        stage = finding.answer.stage
        found[stage] = replace(finding, vocabulary=found[stage].vocabulary)
        report(f"{stage}, with all joints", begun + (1 - begun) * share)
    for judgement in judgements:
        for stage, names in judgement.alike.items():
            found[stage] = found[stage].equal_to(judgement.effect, names)
    return [judgement.text for judgement in judgements]


def _again(jobs: Sequence[_Job], budget_s: float, processes: int) -> Iterator[tuple[float, Finding]]:
    """Yield each stage's finding with what all stages determined together, and the share of the stages before it."""
    done = as_they_come(partial(_examined, budget_s=budget_s), jobs, processes)
    return ((k / len(jobs), finding) for k, (_, finding) in enumerate(done))


def _examined(job: _Job, budget_s: float) -> Finding:
    trials, held, law = job
    return examine(trials, held, budget_s, law=law)


def merged(warnings: Iterable[str], stages: Sequence[str]) -> tuple[str, ...]:
    """Return warnings without repetition: one for all stages of which it says the same."""
    own = dict[str, list[str]]()
    for warning in dict.fromkeys(warnings):
        stage, colon, text = warning.partition(": ")
        own.setdefault(text if colon and stage in stages else warning, []).append(stage)
    found = []
    for text, of in own.items():
        listed = f"all {len(stages)} stages" if 1 < len(stages) == len(of) else ", ".join(of)
        found.append(f"{listed}: {text}" if set(of) <= set(stages) else text)
    return tuple(found)


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
        creeping=tuple(s.answer.stage for s in stages if s.assumed.get(CREEP)),
        gap=gap_of(answers),
        next_experiment=next((s.following for s in gaps if s.following is not None), None),
        warnings=merged(warnings, [answer.stage for answer in answers]),
        equal_sets=tuple(names for s in stages for names in s.decision.equal_sets),
    )
