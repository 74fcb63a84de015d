"""What to do next, in words: the recording that was asked for, and for every set what tells its members apart."""

from itertools import combinations

from softarm.diagnosis.engine.result import Diagnosis
from softarm.diagnosis.report import overlays
from softarm.diagnosis.report.words import known
from softarm.pages.numbers import listed
from softarm.schemas.excitation import EXCITATIONS, Excitation
from softarm.schemas.verdict import NextExperiment


def flight(diagnosis: Diagnosis) -> Excitation | None:
    """The excitation that `softarm excite --plan` would play; None for another rig, which it cannot move."""
    plan = diagnosis.verdict.next_experiment
    return EXCITATIONS.get(plan.excitation) if plan is not None and diagnosis.nominal is not None else None


def steps(diagnosis: Diagnosis) -> list[str]:
    """What to record besides such a flight, a sentence each; empty where nothing is asked for."""
    plan = diagnosis.verdict.next_experiment
    found = []
    if plan is not None and flight(diagnosis) is None:
        found.append(_recording(plan))
    found += _sets(diagnosis)
    if diagnosis.verdict.verdict == "unknown" and plan is None and diagnosis.overlays:
        worst = diagnosis.overlays[overlays.first(diagnosis)]
        found.append(
            f"Record {worst.trial} again, some five times, as nothing shows the gap of {worst.stage} better: "
            "what comes again each time is an effect that nobody has named, what does not is chance."
        )
    return found


def _sets(diagnosis: Diagnosis) -> list[str]:
    """A sentence for every set that the plan does not cover; sets of the same laws are told together."""
    plan = diagnosis.verdict.next_experiment
    asked = frozenset(plan.separates) if plan is not None else frozenset()
    alike: dict[tuple[str, str], list[str]] = {}
    for effect in diagnosis.verdict.effects:
        members = tuple(sorted((effect.name, *effect.equivalents)))
        if effect.equivalents and not asked.issuperset(members):
            stages = {name.rpartition(".")[0] for name in members}
            own = len(stages) == 1
            laws = tuple(name.rpartition(".")[2] for name in members) if own else members
            how = _apart(diagnosis, members)
            said = how.replace(f"{min(stages)}.", "") if own else how
            alike.setdefault((listed(laws), said), []).append(min(stages) if own else "")
    return [
        f"To tell apart {laws}{f' ({listed(sorted(stages))})' if all(stages) else ''}: {how}."
        for (laws, how), stages in alike.items()
    ]


def _recording(plan: NextExperiment) -> str:
    """What to record of another rig; a plan without expectations says why there is nothing to record."""
    whom, signs = listed(plan.separates), dict.fromkeys(plan.expect.values())
    if not signs:
        return f"{whom}: {plan.excitation}." if plan.separates else f"Record this: {plan.excitation}."
    told = f" ({next(iter(signs))})" if len(signs) == 1 else ""
    return f"To tell apart {whom}, record this: {plan.excitation}{told}."


def _apart(diagnosis: Diagnosis, members: tuple[str, ...]) -> str:
    """What the vocabulary says of a set's pairs."""
    said = {(a, b): text for a, b in combinations(members, 2) if (text := separation(diagnosis, a, b))}
    if not said:
        return "nothing in the list of effects says what would; leave it a set, or record other motions"
    if len(members) == 2:
        return next(iter(said.values()))
    return "; ".join(f"{a} and {b}: {text}" for (a, b), text in said.items())


def separation(diagnosis: Diagnosis, one: str, other: str) -> str:
    """What tells two effects apart, as the vocabulary has it; empty where it says nothing."""
    effect = known(diagnosis, one)
    if effect is None or other not in effect.confused_with:
        return ""
    text = f"; {effect.separated_by}"
    start = text.find(f"; {other}: ")
    if start < 0:
        return ""
    start += len(f"; {other}: ")
    ends = (text.find(f"; {name}: ", start) for name in effect.confused_with)
    return text[start : min((end for end in ends if end >= 0), default=len(text))]
