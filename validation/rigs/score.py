"""Scoring of answers about rigs: one outcome for each case, whose meanings are on docs/evidence/rigs.md."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any, Final, Literal, get_args

from validation.rigs import sizes
from validation.rigs.case import CATEGORIES

Outcome = Literal["right", "wide", "part", "picked", "wrong", "silent", "missed", "failed"]
# Their meanings: docs/evidence/rigs.md.
OUTCOMES: Final[tuple[Outcome, ...]] = get_args(Outcome)
# Confidence from which a wrong name counts as confident; a name without confidence counts too.
SURE = 0.8
# Faults that change less than this, relative to noise and tolerances, are too weak to be found.
SEEN = 3.0
WEAK = "too weak"

Names = frozenset[str]


@dataclass(frozen=True, slots=True)
class Scored:
    """Truth, answer and outcome of one case."""

    case: str
    rig: str
    kind: str
    category: str  # or WEAK
    faults: tuple[str, ...]
    verdict: str
    named: tuple[tuple[str, ...], ...]  # sets of names
    outcome: Outcome
    sure: bool  # wrong or picked, with confidence
    clarity: float
    sizes: tuple[bool, ...]  # whether the interval of each comparable size holds the true one
    seconds: float  # processor time


def score(truth: Mapping[str, Any], answer: Mapping[str, Any]) -> Scored:
    """Score an answer (of `benchmark.answer`) against its truth (of `record.write`)."""
    verdict = answer["verdict"]
    effects = verdict["effects"] if verdict else []
    groups = [frozenset(map(local, (e["name"], *e["equivalents"]))) for e in effects]
    stated = verdict["verdict"] if verdict else "failed"
    outcome: Outcome = "failed" if verdict is None else _outcome(truth, stated, groups)
    confidences = [e["confidence"] for e in effects]
    sure = outcome in ("wrong", "picked") and any(c is None or c >= SURE for c in confidences)
    return Scored(
        truth["case"],
        truth["rig"],
        truth["kind"],
        WEAK if truth["causes"] and truth["clarity"] < SEEN else truth["category"],
        tuple(cause["fault"] for cause in truth["causes"]),
        stated,
        tuple(tuple(sorted(group)) for group in groups),
        outcome,
        sure,
        truth["clarity"],
        tuple(sizes.held(truth, answer).values()),
        answer["seconds"],
    )


def local(name: str) -> str:
    """Return an effect's name without stage and joint: `arm.coulomb_friction2` -> `coulomb_friction`."""
    return name.rpartition(".")[2].rstrip("0123456789_")


def _outcome(truth: Mapping[str, Any], stated: str, groups: Sequence[Names]) -> Outcome:
    causes = truth["causes"]
    if not causes:
        if groups:
            return "wrong"
        return "right" if stated == "none" else "silent"
    if not any(cause["names"] for cause in causes):
        near = frozenset[str]().union(*(cause["near"] for cause in causes))
        if not groups:
            return "missed" if stated == "none" else "right"
        return "right" if stated == "incomplete" and all(group <= near for group in groups) else "wrong"
    if not groups:
        return "missed" if stated == "none" else "silent"
    return _named(causes, groups)


def _named(causes: Sequence[Mapping[str, Any]], groups: Sequence[Names]) -> Outcome:
    """Worst outcome of the named sets, each assigned to one known cause."""
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
    """Return for each named effect whether it, with its equivalents, is right for one of the causes."""
    found = {}
    for effect in answer["verdict"]["effects"] if answer["verdict"] else ():
        group = frozenset(map(local, (effect["name"], *effect["equivalents"])))
        met = [c for c in truth["causes"] if group & {*c["names"], *c["tied"]}]
        aside = any(group <= {*c["also"], *c["near"]} for c in truth["causes"])
        found[effect["name"]] = aside or any(_of_a_cause(c, group) in ("right", "wide") for c in met)
    return found


def counts(scored: Sequence[Scored]) -> dict[str, Any]:
    """Return counts of outcomes for all cases and by category and kind, as JSON types."""
    rows = {"all": list(scored)}
    for key in ("category", "kind"):
        for name in dict.fromkeys(getattr(s, key) for s in sorted(scored, key=lambda s: _order(getattr(s, key)))):
            rows[name] = [s for s in scored if getattr(s, key) == name]
    return {name: _row(cases) for name, cases in rows.items() if cases}


def _order(name: str) -> tuple[int, str]:
    known = (*CATEGORIES, WEAK)
    return (known.index(name) if name in known else len(known), name)


def _row(cases: Sequence[Scored]) -> dict[str, Any]:
    counts: dict[str, Any] = {outcome: sum(s.outcome == outcome for s in cases) for outcome in OUTCOMES}
    return {
        "cases": len(cases),
        **counts,
        "sure": sum(s.sure for s in cases),
        "sizes held": sum(sum(s.sizes) for s in cases),
        "sizes": sum(len(s.sizes) for s in cases),
        "seconds_median": median(s.seconds for s in cases),
        "seconds_worst": max(s.seconds for s in cases),
    }


def table(found: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the counts as a Markdown table; `sure` counts confident answers among wrong and picked ones.

    `sizes held` counts the true sizes within their 95 % intervals.
    """
    columns = ("cases", *OUTCOMES, "sure")
    lines = [f"| | {' | '.join(columns)} | sizes held | s (median, worst) |", "|---" * (len(columns) + 3) + "|"]
    for name, row in found.items():
        counts = " | ".join(str(row[c] or "") for c in columns)
        sizes = f"{row['sizes held']} of {row['sizes']}" if row["sizes"] else ""
        lines.append(f"| {name} | {counts} | {sizes} | {row['seconds_median']:.0f}, {row['seconds_worst']:.0f} |")
    return "\n".join(lines)


def wrong_lines(scored: Sequence[Scored]) -> str:
    """Return one line for each wrong, picked or failed answer."""
    lines = []
    for s in sorted(scored, key=lambda s: (OUTCOMES.index(s.outcome), s.rig, s.faults)):
        if s.outcome in ("wrong", "picked", "failed"):
            named = "; ".join(" or ".join(group) for group in s.named) or s.verdict
            sure = ", sure" if s.sure else ""
            truth = " + ".join(s.faults) or "nothing"
            lines.append(f"{s.outcome}{sure}: {s.rig} ({s.category}, {s.case}): {truth}; answer {s.verdict}: {named}")
    return "\n".join(lines)
