"""The next recording in words: the requested experiment, and a way to separate each set of effects."""

from itertools import combinations

from softarm.diagnosis.answer.worst import worst
from softarm.diagnosis.engine.result import Diagnosis
from softarm.diagnosis.report.words import known
from softarm.reporting.numbers import listed
from softarm.schemas.excitation import EXCITATIONS, Excitation
from softarm.schemas.verdict import NextExperiment


def flight(diagnosis: Diagnosis) -> Excitation | None:
    """Return the excitation that `softarm excite --plan` would play, or None for another rig."""
    plan = diagnosis.verdict.next_experiment
    return EXCITATIONS.get(plan.excitation) if plan is not None and diagnosis.nominal is not None else None


def steps(diagnosis: Diagnosis) -> list[str]:
    """Return further recordings to make, one sentence each; empty if none is needed."""
    plan = diagnosis.verdict.next_experiment
    found = []
    if plan is not None and flight(diagnosis) is None:
        found.append(_recording(plan))
    found += _sets(diagnosis)
    if diagnosis.verdict.verdict == "unknown" and plan is None and diagnosis.overlays:
        largest = diagnosis.overlays[worst(diagnosis)]
        found.append(
            f"Repeat {largest.trial} about five times; it shows the gap of {largest.stage} best. "
            "A part that repeats is an unknown effect; a part that does not is chance."
        )
    return found


def _sets(diagnosis: Diagnosis) -> list[str]:
    """Return a sentence for every set that the plan does not cover; sets of the same laws share one."""
    plan = diagnosis.verdict.next_experiment
    planned = frozenset(plan.separates) if plan is not None else frozenset()
    stages_by_text: dict[tuple[str, str], list[str]] = {}
    for effect in diagnosis.verdict.effects:
        members = tuple(sorted((effect.name, *effect.equivalents)))
        if effect.equivalents and not planned.issuperset(members):
            stages = {name.rpartition(".")[0] for name in members}
            own = len(stages) == 1
            laws = tuple(name.rpartition(".")[2] for name in members) if own else members
            how = _separations(diagnosis, members)
            text = how.replace(f"{min(stages)}.", "") if own else how
            stages_by_text.setdefault((listed(laws), text), []).append(min(stages) if own else "")
    return [
        f"To separate {laws}{f' ({listed(sorted(stages))})' if all(stages) else ''}: {how}."
        for (laws, how), stages in stages_by_text.items()
    ]


def _recording(plan: NextExperiment) -> str:
    """Return the recording to make on another rig; a plan without expectations states why there is none."""
    effects, signs = listed(plan.separates), dict.fromkeys(plan.expect.values())
    if not signs:
        return f"{effects}: {plan.excitation}." if plan.separates else f"Record {plan.excitation}."
    expected = f" ({next(iter(signs))})" if len(signs) == 1 else ""
    return f"To separate {effects}, record {plan.excitation}{expected}."


def _separations(diagnosis: Diagnosis, members: tuple[str, ...]) -> str:
    found = {(a, b): text for a, b in combinations(members, 2) if (text := separation(diagnosis, a, b))}
    if not found:
        return "no experiment is known; keep the alternatives, or record other motions"
    if len(members) == 2:
        return next(iter(found.values()))
    return "; ".join(f"{a} and {b}: {text}" for (a, b), text in found.items())


def separation(diagnosis: Diagnosis, one: str, other: str) -> str:
    """Return how the vocabulary separates two effects, or an empty string."""
    effect = known(diagnosis, one)
    return "" if effect is None else effect.separated_by.get(other, "")
