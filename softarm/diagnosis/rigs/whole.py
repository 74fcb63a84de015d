"""Effects of the whole mechanism: one payload, body or tilted base loads several joints, and has one size for all.

Each joint alone takes such an effect for one of its own, or one of its own for such an effect. All joints together
separate them: a search over all stages at once compares one common effect with the effects that each stage showed.
"""

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from softarm.diagnosis.answer.assembly import share
from softarm.diagnosis.data.trials import Trial, TrialError
from softarm.diagnosis.engine import shrink, work
from softarm.diagnosis.engine.candidates import Candidate, FittedParameter, Nuisance, parameters_of
from softarm.diagnosis.engine.confidence import confidence
from softarm.diagnosis.engine.examination import Examination
from softarm.diagnosis.engine.fitted import FittedChoice
from softarm.diagnosis.engine.problem import Setup
from softarm.diagnosis.engine.search import SHARE_MIN, SelectedEffect
from softarm.diagnosis.engine.thresholds import RIG
from softarm.diagnosis.rigs.candidates import candidate, candidates, nuisances, starts
from softarm.diagnosis.rigs.mjcf.effects import MASS, adds_mass
from softarm.diagnosis.rigs.stage import RESTARTS_BOUND, Finding, Held, estimates, part_of, squares_of, view_of
from softarm.diagnosis.rigs.subsample import PLANNED, Stretches, together
from softarm.diagnosis.rigs.views import RigView
from softarm.schemas.verdict import NamedEffect, Shrink

# Effects of single joints that may be a payload or an error of one body's mass.
OF_BODIES = "length", "mass", "payload"
# Effects that the search of a stage with a gap without a cause has found, at most, if it takes part.
FEW = 4


@dataclass(frozen=True, slots=True)
class Judgement:
    """Decision of all stages together on one effect of the whole mechanism."""

    effect: str
    held: Mapping[str, Held]  # by stage: of each stage with a gap that the effect loads
    text: str  # what a reader of the verdict needs to know
    alike: Mapping[str, Sequence[str]] = field(default_factory=dict)  # by stage: named effects that may be this one


def judged(
    own: Mapping[str, Sequence[Trial]], found: Mapping[str, Finding], budget_s: float = math.inf
) -> list[Judgement]:
    """Return a judgement on each effect of the whole mechanism that a stage showed and several stages can show.

    Args:
        own: trials of each stage.
        found: finding of each stage on its own.
        budget_s: processor time of the search, s; of longer recordings the most informative stretches are used.
    """
    loaded = _loaded(found)
    if not loaded:
        return []
    made = dict[str, tuple[RigView, Stretches]]()
    for stage, trials in _common_trials(own, {s for stages in loaded.values() for s in stages}).items():
        if not trials:
            return []
        view, windows = view_of(trials)
        made[stage] = view.adopt(found[stage].assumed), windows
    try:
        joint, common = _searched(made, loaded, found, budget_s)
        chosen = joint.choice.chosen
        # Nuisances act otherwise beside a common effect.
        plain = {each.name for each in common.values()}.isdisjoint(chosen.names)
        sized = joint if plain else joint.on(joint.setup.beside(chosen))
    except TrialError:  # a joint stands still in the most informative stretches: each keeps its own finding
        return []
    judgements = (
        _judged(effect, common[effect, part], joint, sized, {s: made[s][0] for s in stages}, found)
        for (effect, part), stages in loaded.items()
    )
    return [each for each in judgements if each is not None]


def _common_trials(own: Mapping[str, Sequence[Trial]], stages: Iterable[str]) -> dict[str, list[Trial]]:
    """Return the trials of some stages in the recordings that all of them have; a joint may stand still in one."""
    of = {stage: {t.name.removesuffix(f"/{stage}"): t for t in own[stage]} for stage in sorted(stages)}
    common = set.intersection(*map(set, of.values()))
    return {stage: [t for name, t in each.items() if name in common] for stage, each in of.items()}


def _loaded(found: Mapping[str, Finding]) -> dict[tuple[str, str], list[str]]:
    """Return the effects of the whole to judge: effect and the part that has it -> the stages that it loads.

    An effect is judged if a stage shows it, that of a body also if a stage shows an effect that may be this one. The
    mass of the last link differs from a payload by its inertia, which only the joint that moves nothing else shows. A
    gap that no effect of its joint explains may be a load across the link, whose place all joints together show.
    """
    stages_of: dict[tuple[str, str], list[str]] = {}
    for stage in sorted(found):
        for effect, part in found[stage].whole.items():
            if _speaks(found[stage], effect):
                stages_of.setdefault((effect, part), []).append(stage)
    shown = {name for finding in found.values() for name in _names(finding)}
    heavier = {stage for stage in found if any(f"{stage}.{effect}" in shown for effect in OF_BODIES)}
    last = {part.removeprefix("end ") for effect, part in stages_of if effect == "payload"}

    def is_open(effect: str, part: str, stages: Sequence[str]) -> bool:
        if part in last:
            return any(f"{s}.mass" in shown for s in stages if _bodies(found[s]) == [effect])
        if any(f"{s}.{effect}" in shown for s in stages):
            return True
        across = effect == "payload" and any(found[s].decision.kind == "unknown" for s in stages)
        return across or (adds_mass(effect) and not heavier.isdisjoint(stages))

    return {
        (effect, part): stages
        for (effect, part), stages in stages_of.items()
        if len(stages) > 1 and is_open(effect, part, stages)
    }


def _bodies(finding: Finding) -> list[str]:
    """Return the masses of single bodies that a stage can show."""
    return [effect for effect in finding.whole if effect.startswith(MASS)]


def _speaks(finding: Finding, effect: str) -> bool:
    """Return whether a stage can show an effect of the whole mechanism, or that it is absent.

    A gap without a cause hides both, unless the effect is a named one or as good. The cause may be a heavier body or a
    payload if no effect is named and few were found; many would make the search long.
    """
    shows = f"{finding.answer.stage}.{effect}" in _names(finding)
    few = adds_mass(effect) and not finding.named and len(finding.fitted) <= FEW
    return bool(_sizes(finding, effect)) and (shows or few or not finding.is_unexplained)


def _names(finding: Finding) -> Iterator[str]:
    """Yield the named effects of a stage and those that its recordings cannot separate from them."""
    for effect in finding.named:
        yield from (effect.name, *effect.equivalents)


def _searched(
    made: Mapping[str, tuple[RigView, Stretches]],
    loaded: Mapping[tuple[str, str], Sequence[str]],
    found: Mapping[str, Finding],
    budget_s: float,
) -> tuple[Examination, dict[tuple[str, str], Candidate]]:
    """Search over all stages at once; return it, and the candidate of each effect of the whole mechanism."""
    views, used = [view for view, _ in made.values()], next(iter(made.values()))[1]
    common = {
        (effect, part): _common(effect, part, [made[stage][0] for stage in stages])
        for (effect, part), stages in loaded.items()
    }
    judged = {f"{stage}.{effect}" for (effect, _), stages in loaded.items() for stage in stages}
    # The mass behind a joint that moves one body is the mass of that body.
    judged |= {f"{v.stage}.mass" for v in views if len(v.together) == 1 and v.together[0].name in judged}
    # What a stage may have instead: fitted effects, and those like its named ones.
    known = {name for stage in made for name in (*found[stage].fitted, *_names(found[stage]))} - judged
    rivals = [c for view in views for c in candidates(view) if c.name in known]
    searched = (*common.values(), *rivals)
    planned_s = work.backward(len(searched), len(parameters_of(searched))) * sum(view.rollout_s for view in views)
    thresholds = RIG
    if PLANNED * budget_s < planned_s:
        thresholds = replace(RIG, search=replace(RIG.search, restarts=RESTARTS_BOUND))
        kept, _, _ = together(PLANNED * budget_s / planned_s, views, [stretches for _, stretches in made.values()])
        views, used = [part_of(each).adopt(v.assumed) for v, each in zip(views, kept, strict=True)], kept[0]
    free, kinds = tolerated(views, loaded, judged), [t.kind for t in used.trials]
    setup = Setup(views, free, kinds, used.origins, views[0].block_s)
    return Examination(setup, searched, thresholds, lambda text, done: None), common


def tolerated(
    views: Sequence[RigView], loaded: Mapping[tuple[str, str], Sequence[str]], judged: Collection[str]
) -> list[Nuisance]:
    """Return the nuisances of all stages; one for all stages that share a parameter of a judged effect.

    Args:
        views: views of the stages.
        loaded: effect and the part that has it -> the stages that it loads.
        judged: effects of single stages that may be one of these.
    """
    own = {n.path: n for view in views for n in nuisances(view)}
    common = {
        f"{part}{path.removeprefix(stage)}": n
        for (effect, part), stages in loaded.items()
        for stage in stages
        for path, n in own.items()
        if path.startswith(f"{stage}.{effect}.")
    }
    alone = [n for path, n in own.items() if path.rpartition(".")[0] not in judged]
    return [*alone, *(replace(n, path=path) for path, n in common.items())]


def _judged(
    effect: str,
    common: Candidate,
    joint: Examination,
    sized: FittedChoice,
    stages: Mapping[str, RigView],
    found: Mapping[str, Finding],
) -> Judgement | None:
    """Return the judgement on one effect, or None if the stages together leave it open.

    Args:
        effect: the effect.
        common: its candidate, with one size for all stages.
        joint: search over all stages.
        sized: its choice, with the sizes to state.
        stages: views of the stages that the effect loads.
        found: finding of each stage on its own.
    """
    chosen = {each.candidate.name: each for each in joint.choice.selected}
    if common.name in chosen and _holds(joint, chosen[common.name]):
        judgement = _named(effect, sized, chosen[common.name], stages, found)
        if judgement is not None:
            return judgement
    if alike := _alike(effect, common.name, chosen.values(), {stage: found[stage] for stage in stages}):
        what, names = effect.replace(MASS, "mass of "), ", ".join(name for own in alike.values() for name in own)
        return Judgement(effect, {}, f"the recordings cannot separate {what} from {names}", alike)
    if any(common.name in each.equivalents for each in chosen.values()):
        return None
    against = [stage for stage in stages if f"{stage}.{effect}" in _names(found[stage])]
    if not against:
        return None
    others = ", ".join(stage for stage in stages if stage not in against)
    why = f"the motion of {others} contradicts it" if others else "no one size explains all of them"
    return Judgement(
        effect,
        {stage: Held(effect, {}) for stage in against},
        f"{', '.join(against)}: {effect} alone would explain the gap, but {why}",
    )


def _alike(
    effect: str, common: str, chosen: Iterable[SelectedEffect], found: Mapping[str, Finding]
) -> dict[str, list[str]]:
    """Return the named effects of stages that all stages together cannot separate from another one, by stage.

    Args:
        effect: the other effect, which is none of the named ones nor of those that a stage cannot separate from them.
        common: its candidate.
        chosen: effects of the search over all stages.
        found: finding of each stage on its own.
    """
    classes = ({each.candidate.name, *each.equivalents} for each in chosen)
    same = {name for names in classes if common in names for name in names}
    alike = {
        stage: [e.name for e in of.named if same & {e.name, *e.equivalents}]
        for stage, of in found.items()
        if f"{stage}.{effect}" not in _names(of)
    }
    return {stage: names for stage, names in alike.items() if names}


def _common(effect: str, part: str, views: Sequence[RigView]) -> Candidate:
    """Return the effect with one size for all views, with the widest bounds and the median usual change.

    The smallest one, of a light wrist, would hold a payload of a kilogram near zero.
    """
    same: dict[str, list[FittedParameter]] = {}
    for view in views:
        (own,) = (each for each in view.vocabulary if each.name == f"{view.stage}.{effect}")
        for parameter in candidate(view, own).parameters:
            same.setdefault(parameter.path.rpartition(".")[2], []).append(parameter)
    parameters = tuple(
        replace(
            sorted(each, key=lambda d: d.size)[len(each) // 2],
            path=f"{part}.{effect}.{name}",
            low=min(d.low for d in each),
            high=max(d.high for d in each),
            tolerance=max(d.tolerance for d in each),
        )
        for name, each in same.items()
    )
    return Candidate(f"{part}.{effect}", part, parameters, starts(parameters))


def _holds(joint: Examination, effect: SelectedEffect) -> bool:
    """Return whether an effect certainly shrinks the gap and is against no stage, with a size at no bound nor zero."""
    fit = joint.choice.chosen
    bound = effect.candidate.at_bound(fit.u[fit.names.index(effect.candidate.name)])
    against = min(effect.gain.energies.values()) < -RIG.gain.ignored
    is_open = effect.candidate.name in joint.open_effects(fit)
    return effect.gain.low > 0 and not bound and not against and not is_open


def _named(
    effect: str,
    joint: FittedChoice,
    selected: SelectedEffect,
    stages: Mapping[str, RigView],
    found: Mapping[str, Finding],
) -> Judgement | None:
    """Return the judgement on an effect that the search over all stages has chosen, or None if no gap shows it."""
    fit, name = joint.choice.chosen, selected.candidate.name
    sizes, without = estimates(joint, fit, name), joint.without_each(fit)[name]
    loaded = [stage for stage in stages if found[stage].decision.kind != "none"]
    shown = tuple(stage for stage in loaded if selected.gain.shares.get(stage, 0.0) > SHARE_MIN)
    if not shown:
        return None

    held = dict[str, Held]()
    for stage in loaded:
        own, parameters = f"{stage}.{effect}", {key: sizes[key] for key in _sizes(found[stage], effect)}
        held[stage] = Held(effect, parameters)
        if stage in shown:
            before, after = (squares_of(joint, each, stage) for each in (without, fit))
            alike = [other for other in selected.equivalents if other.startswith(f"{stage}.")]
            alike += stages[stage].indistinguishable.get(own, ())
            named = NamedEffect(
                name=own,
                parameters=parameters,
                confidence=confidence("rig", selected),
                equivalents=tuple(dict.fromkeys(alike)),
                shared_by=shown if len(shown) > 1 else (),
                shrink=Shrink(stage=share(*shrink.interval(before, after))),
            )
            held[stage] = replace(held[stage], named=named)
    return Judgement(
        effect,
        held,
        f"{', '.join(shown)}: one {effect.replace(MASS, 'mass of ')} explains the gap, with one size for all joints",
    )


def _sizes(finding: Finding, effect: str) -> list[str]:
    """Return the names of an effect's parameters, none if it does not load the stage."""
    return [p.name for e in finding.vocabulary if e.name == f"{finding.answer.stage}.{effect}" for p in e.parameters]
