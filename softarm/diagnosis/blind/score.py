"""Scoring of answers about the soft arm (`score`) and about rigs (`score_rig`).

Answers about the soft arm give shares, calibration, coverage and a list of the wrong ones; docs/evidence/blind.md
defines the measures. Answers about rigs give one outcome for each case (docs/evidence/rigs.md).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from statistics import median
from typing import Any, Final, Literal, get_args

from softarm.common.shares import Share, share
from softarm.diagnosis.blind import rig_sizes
from softarm.diagnosis.blind.imperfections import SAME_SIZE, Cause
from softarm.reality.rigs.case import CATEGORIES
from softarm.schemas.verdict import Interval, NamedEffect, Verdict

BINS = 10
SET_MAX = 2


@dataclass(frozen=True, slots=True)
class Scored:
    """Truth and answer of one case."""

    case: str
    kind: str  # one of `cases.Kind`
    causes: tuple[Cause, ...]
    verdict: Verdict | None  # None if the tool failed
    failure: str = ""
    measured_shrink: Mapping[str, float] | None = None  # by stage and for `chain`, on fresh trials; None: not measured

    @property
    def cause_names(self) -> tuple[str, ...]:
        """Names of the causes."""
        return tuple(cause.name for cause in self.causes)

    @property
    def sizes(self) -> dict[str, float]:
        """True parameters of the registry, `stage.effect.parameter` -> value."""
        return {SAME_SIZE[path]: x for cause in self.causes for path, x in cause.settings.items() if path in SAME_SIZE}

    @property
    def effects(self) -> tuple[NamedEffect, ...]:
        """Named effects of the answer."""
        return self.verdict.effects if self.verdict else ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the named effects."""
        return tuple(effect.name for effect in self.effects)

    @property
    def right_stage(self) -> bool:
        """Whether the gap was located in a stage with a cause."""
        return self.verdict is not None and any(self.verdict.where.stage == cause.stage for cause in self.causes)

    @property
    def exact_or_set(self) -> bool:
        """Whether there is one name for each cause, which is the cause or has it as its only equivalent."""
        if self.verdict is None or len(self.effects) != len(self.causes):
            return False
        sets = [answer_set(effect) for effect in self.effects]
        return all(len(s) <= SET_MAX for s in sets) and any(
            all(cause in s for cause, s in zip(self.cause_names, order, strict=True)) for order in permutations(sets)
        )

    @property
    def right(self) -> bool:
        """Whether the answer is entirely right."""
        if self.kind in ("none", "unknown"):
            return self.verdict is not None and not self.names and self.verdict.verdict == self.kind
        return self.exact_or_set


def answer_set(effect: NamedEffect) -> frozenset[str]:
    """Return an effect together with its equivalents."""
    return frozenset((effect.name, *effect.equivalents))


ALONE, SEVERAL = ("single",), ("two", "three")
_SAID: dict[str, Callable[[Scored], bool]] = {
    "exact": lambda s: sorted(s.names) == sorted(s.cause_names),
    "exact or in sets of two": lambda s: s.exact_or_set,
}
# Measure -> the kinds of case that it covers, and whether a case is a hit.
MEASURES: dict[str, tuple[tuple[str, ...], Callable[[Scored], bool]]] = {
    "right in all": ((*ALONE, *SEVERAL, "none", "unknown"), lambda s: s.right),
    "right stage": ((*ALONE, *SEVERAL, "unknown"), lambda s: s.right_stage),
    "right stage, single": (("single",), lambda s: s.right_stage),
    **{f"{kind}, {said}": ((kind,), hit) for kind in (*ALONE, *SEVERAL) for said, hit in _SAID.items()},
    "single, named first": (("single",), lambda s: bool(s.names) and s.names[0] in s.cause_names),
    "two or three, at least one": (SEVERAL, lambda s: any(name in s.cause_names for name in s.names)),
    "known, a wrong name beside": (
        (*ALONE, *SEVERAL),
        lambda s: any(answer_set(effect).isdisjoint(s.cause_names) for effect in s.effects),
    ),
    "unknown, given a name": (("unknown",), lambda s: bool(s.names)),
    "unknown, given a name as the whole answer": (
        ("unknown",),
        lambda s: s.verdict is not None and s.verdict.verdict == "named",
    ),
    "unknown, said so": (("unknown",), lambda s: s.verdict is not None and s.verdict.verdict == "unknown"),
    "none, given a name": (("none",), lambda s: bool(s.names)),
    "none, said so": (("none",), lambda s: s.verdict is not None and s.verdict.verdict == "none"),
    "failed": ((*ALONE, *SEVERAL, "unknown", "none"), lambda s: s.verdict is None),
}


def score(cases: Sequence[Scored]) -> dict[str, Any]:
    """Return all measures, calibration, coverage and wrong answers as JSON types."""
    return {
        "cases": len(cases),
        "measures": {
            name: share(hit(case) for case in cases if case.kind in kinds) for name, (kinds, hit) in MEASURES.items()
        },
        "by_cause": by_cause(cases),
        "calibration": calibration(cases),
        "coverage": coverage(cases),
        "wrong": [wrong(case) for case in cases if not case.right],
    }


def by_cause(cases: Sequence[Scored]) -> dict[str, Share]:
    """Return the share of right answers for each single cause; ' (removed)' marks those removed from the model file."""
    hits: dict[str, list[bool]] = {}
    for case in cases:
        if case.kind in (*ALONE, "unknown"):
            hits.setdefault(_shown(case.causes[0]), []).append(case.right)
    return {name: share(hits[name]) for name in sorted(hits)}


def calibration(cases: Sequence[Scored]) -> dict[str, Any]:
    """Compare confidences with shares of right names, in ten bins of equal width.

    A name is right if the effect or one of its equivalents is a cause. The ECE is the mean difference over all names.
    """
    pairs = [
        (effect.confidence, not answer_set(effect).isdisjoint(case.cause_names))
        for case in cases
        for effect in case.effects
        if effect.confidence is not None
    ]
    bins, off = [], []
    for i in range(BINS):
        inside = [(c, r) for c, r in pairs if min(int(c * BINS), BINS - 1) == i]
        mean = sum(c for c, _ in inside) / len(inside) if inside else None
        off.append(abs(sum(c - r for c, r in inside)))
        bins.append({"from": i / BINS, "to": (i + 1) / BINS, "confidence": mean, **share(r for _, r in inside)})
    ece = sum(off) / len(pairs) if pairs else None
    return {"ece": ece, "named": len(pairs), "bins": bins}


def coverage(cases: Sequence[Scored]) -> dict[str, Any]:
    """Return how often a 95 % interval of the shrink contains the value measured on fresh trials.

    An effect's interval is conditional on the others, so only effects alone in their stage count; for `chain`, only
    single effects. `width` is the median width of an interval, `bias` the mean of measured minus predicted shrink.
    `size` counts the parameters of rightly named effects whose true values are known; its width and bias are relative.
    """
    stage, chain, size = [], [], []
    for case in cases:
        for effect in case.effects:
            for name, estimate in effect.parameters.items():
                true = case.sizes.get(f"{effect.name}.{name}")
                if true:
                    low, value, high = (x / true for x in (estimate.low, estimate.value, estimate.high))
                    size.append((Interval(value=value, low=min(low, high), high=max(low, high)), 1.0))
        if case.measured_shrink is None:
            continue
        for effect in case.effects:
            name = effect.name.partition(".")[0]
            alone = sum(other.partition(".")[0] == name for other in case.names) == 1
            if alone and name in case.measured_shrink:
                stage.append((effect.shrink.stage, case.measured_shrink[name]))
            if effect.shrink.chain and len(case.names) == 1 and "chain" in case.measured_shrink:
                chain.append((effect.shrink.chain, case.measured_shrink["chain"]))
    found = {}
    for name, pairs in (("stage", stage), ("chain", chain), ("size", size)):
        widths = sorted(interval.high - interval.low for interval, _ in pairs)
        found[name] = {
            **share(interval.low <= value <= interval.high for interval, value in pairs),
            "width": widths[len(widths) // 2] if widths else None,
            "bias": sum(value - interval.value for interval, value in pairs) / len(pairs) if pairs else None,
        }
    return found


def wrong(case: Scored) -> dict[str, Any]:
    """Return a wrong answer with the truth, as JSON types."""
    return {
        "case": case.case,
        "kind": case.kind,
        "causes": [_shown(cause) for cause in case.causes],
        "verdict": case.verdict.verdict if case.verdict else f"failed: {case.failure}",
        "stage": case.verdict.where.stage if case.verdict else None,
        "named": [
            {"name": e.name, "equivalents": list(e.equivalents), "confidence": e.confidence} for e in case.effects
        ],
    }


def _shown(cause: Cause) -> str:
    return cause.name + (" (removed)" if cause.removed else "")


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
class ScoredRig:
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


def score_rig(truth: Mapping[str, Any], answer: Mapping[str, Any]) -> ScoredRig:
    """Score an answer (of `rigs.answer`) against its truth (of `reality.rigs.record.write`)."""
    verdict = answer["verdict"]
    effects = verdict["effects"] if verdict else []
    groups = [frozenset(map(local, (e["name"], *e["equivalents"]))) for e in effects]
    stated = verdict["verdict"] if verdict else "failed"
    outcome: Outcome = "failed" if verdict is None else _outcome(truth, stated, groups)
    confidences = [e["confidence"] for e in effects]
    sure = outcome in ("wrong", "picked") and any(c is None or c >= SURE for c in confidences)
    return ScoredRig(
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
        tuple(rig_sizes.held(truth, answer).values()),
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


def rig_counts(scored: Sequence[ScoredRig]) -> dict[str, Any]:
    """Return counts of outcomes for all cases and by category and kind, as JSON types."""
    rows = {"all": list(scored)}
    for key in ("category", "kind"):
        for name in dict.fromkeys(getattr(s, key) for s in sorted(scored, key=lambda s: _order(getattr(s, key)))):
            rows[name] = [s for s in scored if getattr(s, key) == name]
    return {name: _row(cases) for name, cases in rows.items() if cases}


def _order(name: str) -> tuple[int, str]:
    known = (*CATEGORIES, WEAK)
    return (known.index(name) if name in known else len(known), name)


def _row(cases: Sequence[ScoredRig]) -> dict[str, Any]:
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
