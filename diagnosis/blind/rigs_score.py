"""What the answers on other people's rigs are worth: one word a case, shares by category and by kind. Pure."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any, Final, Literal, get_args

Outcome = Literal["right", "wide", "part", "picked", "wrong", "silent", "missed", "failed"]
OUTCOMES: Final[tuple[Outcome, ...]] = get_args(Outcome)
MEANINGS: Final[Mapping[Outcome, str]] = {
    "right": "what is wrong, all of it, with nothing beside it but what the data cannot tell from it",
    "wide": "the same in sets that hold more than they need",
    "part": "one of two causes, and nothing wrong",
    "picked": "one of several that the data cannot tell apart, as if the others were out",
    "wrong": "a name of what is not there",
    "silent": "unknown, where something known is wrong, or nothing",
    "missed": "none, where something is wrong",
    "failed": "an error",
}
SURE = 0.8  # a wrong name with such a confidence is a confident one; without any confidence it counts as one
SEEN = 3.0  # a fault that changes less, in noise and tolerances, is too weak to ask for
WEAK = "too weak"

Names = frozenset[str]


@dataclass(frozen=True, slots=True)
class Scored:
    """One case's answer beside its truth."""

    case: str
    rig: str
    kind: str
    category: str  # or WEAK
    faults: tuple[str, ...]
    verdict: str
    said: tuple[tuple[str, ...], ...]  # sets of names
    outcome: Outcome
    sure: bool  # wrong or picked, and confident
    clarity: float
    seconds: float  # of a processor


def score(truth: Mapping[str, Any], answer: Mapping[str, Any]) -> Scored:
    """Score one answer (see `rigs.answer`) against its truth (`reality.rigs.record.write`)."""
    verdict = answer["verdict"]
    effects = verdict["effects"] if verdict else []
    groups = [frozenset(map(local, (e["name"], *e["equivalents"]))) for e in effects]
    said = verdict["verdict"] if verdict else "failed"
    outcome: Outcome = "failed" if verdict is None else _outcome(truth, said, groups)
    confidences = [e["confidence"] for e in effects]
    sure = outcome in ("wrong", "picked") and any(c is None or c >= SURE for c in confidences)
    return Scored(
        truth["case"],
        truth["rig"],
        truth["kind"],
        WEAK if truth["causes"] and truth["clarity"] < SEEN else truth["category"],
        tuple(cause["fault"] for cause in truth["causes"]),
        said,
        tuple(tuple(sorted(group)) for group in groups),
        outcome,
        sure,
        truth["clarity"],
        answer["seconds"],
    )


def local(name: str) -> str:
    """An effect's name without its stage and its joint: `arm.coulomb_friction2`, `arm2.coulomb_friction` alike."""
    return name.rpartition(".")[2].rstrip("0123456789_")


def _outcome(truth: Mapping[str, Any], said: str, groups: Sequence[Names]) -> Outcome:
    causes = truth["causes"]
    if not causes:
        return "wrong" if groups else "right" if said == "none" else "silent"
    if not any(cause["names"] for cause in causes):
        near = frozenset[str]().union(*(cause["near"] for cause in causes))
        if not groups:
            return "missed" if said == "none" else "right"
        return "right" if said == "incomplete" and all(group <= near for group in groups) else "wrong"
    if not groups:
        return "missed" if said == "none" else "silent"
    return _named(causes, groups)


def _named(causes: Sequence[Mapping[str, Any]], groups: Sequence[Names]) -> Outcome:
    """Of known causes, and an answer with names: the worst of what its sets are, if they can be shared out at all."""
    left = list(causes)
    found: list[Outcome] = []
    worst: Outcome
    for group in groups:
        met = next((c for c in left if group & set(c["names"])), None) or next(
            (c for c in left if group & set(c["tied"])), None
        )
        if met is None:
            if any(group <= set(c["also"]) for c in causes):
                continue
            return "wrong"
        left.remove(met)
        found.append(_of_a_cause(met, group))
    worst = max(found, key=OUTCOMES.index) if found else "silent"
    return "part" if left and worst in ("right", "wide") else worst


def _of_a_cause(cause: Mapping[str, Any], group: Names) -> Outcome:
    names, tied, must = (set(cause[key]) for key in ("names", "tied", "must"))
    if not must <= group or not group & names:
        return "picked"
    return "right" if group <= names | tied else "wide"


def right_names(truth: Mapping[str, Any], answer: Mapping[str, Any]) -> dict[str, bool]:
    """Named effect -> whether it, with its equivalents, is the answer to one of the causes; the rest may be missing."""
    found = {}
    for effect in answer["verdict"]["effects"] if answer["verdict"] else ():
        group = frozenset(map(local, (effect["name"], *effect["equivalents"])))
        met = [c for c in truth["causes"] if group & {*c["names"], *c["tied"]}]
        aside = any(group <= {*c["also"], *c["near"]} for c in truth["causes"])
        found[effect["name"]] = aside or any(_of_a_cause(c, group) in ("right", "wide") for c in met)
    return found


def shares(scored: Sequence[Scored]) -> dict[str, Any]:
    """Counts of outcomes for all, and by category and kind; JSON types only."""
    rows = {"all": list(scored)}
    for key in ("category", "kind"):
        for name in dict.fromkeys(getattr(s, key) for s in sorted(scored, key=lambda s: _order(getattr(s, key)))):
            rows[name] = [s for s in scored if getattr(s, key) == name]
    return {name: _row(cases) for name, cases in rows.items() if cases}


def _order(name: str) -> tuple[int, str]:
    known = ("single", "half", "two", "set", "none", "unknown", WEAK)
    return (known.index(name) if name in known else len(known), name)


def _row(cases: Sequence[Scored]) -> dict[str, Any]:
    counts: dict[str, Any] = {outcome: sum(s.outcome == outcome for s in cases) for outcome in OUTCOMES}
    return {
        "cases": len(cases),
        **counts,
        "sure": sum(s.sure for s in cases),
        "seconds_median": median(s.seconds for s in cases),
        "seconds_worst": max(s.seconds for s in cases),
    }


def table(found: Mapping[str, Mapping[str, Any]]) -> str:
    """The shares as a Markdown table; `sure`: of wrong and picked, with confidence."""
    columns = ("cases", *OUTCOMES, "sure")
    lines = [f"| | {' | '.join(columns)} | s (median, worst) |", "|---" * (len(columns) + 2) + "|"]
    for name, row in found.items():
        counts = " | ".join(str(row[c] or "") for c in columns)
        lines.append(f"| {name} | {counts} | {row['seconds_median']:.0f}, {row['seconds_worst']:.0f} |")
    return "\n".join(lines)


def listed(scored: Sequence[Scored], outcomes: Sequence[Outcome] = ("wrong", "picked", "failed")) -> str:
    """One line for each case with such an outcome."""
    lines = []
    for s in sorted(scored, key=lambda s: (OUTCOMES.index(s.outcome), s.rig, s.faults)):
        if s.outcome in outcomes:
            said = "; ".join(" or ".join(group) for group in s.said) or s.verdict
            sure = ", sure" if s.sure else ""
            truth = " + ".join(s.faults) or "nothing"
            lines.append(f"{s.outcome}{sure}: {s.rig} ({s.category}, {s.case}): {truth}; said {s.verdict}: {said}")
    return "\n".join(lines)
