"""How good the answers are: shares, calibration, coverage, every wrong one by name. Pure; defined in docs/blind.md."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Any

from softarm.schemas.verdict import NamedEffect, Verdict

BINS = 10
_Z95 = 1.959964
SET_MAX = 2


@dataclass(frozen=True, slots=True)
class Scored:
    """One case: what was true and what was said."""

    case: str
    kind: str  # of `cases.Kind`
    causes: tuple[str, ...]
    stages: tuple[str, ...]  # of the causes
    removed: tuple[bool, ...]  # of the causes: out of the model file
    verdict: Verdict | None  # None: the tool fell over
    failure: str = ""
    measured_shrink: Mapping[str, float] | None = None  # stage, and `chain`, on fresh trials; None: not measured

    @property
    def effects(self) -> tuple[NamedEffect, ...]:
        """What was named."""
        return self.verdict.effects if self.verdict else ()

    @property
    def names(self) -> tuple[str, ...]:
        """What was named, by name."""
        return tuple(effect.name for effect in self.effects)

    @property
    def right_stage(self) -> bool:
        """Whether the gap was found in a stage in which there is a cause."""
        return self.verdict is not None and self.verdict.where.stage in self.stages

    @property
    def exact(self) -> bool:
        """Whether every cause was named and nothing else."""
        return self.verdict is not None and sorted(self.names) == sorted(self.causes)

    @property
    def exact_or_set(self) -> bool:
        """As `exact`, or a cause is the only equivalent of what was named for it: one name for one cause."""
        if self.verdict is None or len(self.effects) != len(self.causes):
            return False
        sets = [answer_set(effect) for effect in self.effects]
        return all(len(s) <= SET_MAX for s in sets) and any(
            all(cause in s for cause, s in zip(self.causes, order, strict=True)) for order in permutations(sets)
        )

    @property
    def first_right(self) -> bool:
        """Whether the effect that was named first is a cause, whatever came after."""
        return bool(self.names) and self.names[0] in self.causes

    @property
    def right(self) -> bool:
        """Whether this is the answer that was wanted."""
        if self.kind in ("none", "unknown"):
            return self.verdict is not None and not self.names and self.verdict.verdict == self.kind
        return self.exact_or_set


def answer_set(effect: NamedEffect) -> frozenset[str]:
    """An effect and what it cannot be told apart from."""
    return frozenset((effect.name, *effect.equivalents))


def share(hits: Iterable[bool]) -> dict[str, float | int | None]:
    """Share of hits with its 95 % interval (Wilson 1927), and of how many; no share of none."""
    found = list(hits)
    n, k = len(found), sum(found)
    if n == 0:
        return {"share": None, "low": None, "high": None, "hits": 0, "of": 0}
    p, z2 = k / n, _Z95**2
    middle, half = p + z2 / (2 * n), _Z95 * math.sqrt(p * (1 - p) / n + z2 / (4 * n * n))
    low, high = (max(0.0, (middle - half) / (1 + z2 / n)), min(1.0, (middle + half) / (1 + z2 / n)))
    return {"share": p, "low": low, "high": high, "hits": k, "of": n}


ALONE, SEVERAL = ("single", "half"), ("two", "uneven", "three")
_SAID: dict[str, Callable[[Scored], bool]] = {
    "exact": lambda s: s.exact,
    "exact or in sets of two": lambda s: s.exact_or_set,
}
_TITLES = {
    "single": "single",
    "half": "single at half strength",
    "two": "two",
    "uneven": "two, the second at half strength",
    "three": "three",
}
# Measure -> the kinds of case that it is about, and when a case counts.
MEASURES: dict[str, tuple[tuple[str, ...], Callable[[Scored], bool]]] = {
    "right in all": ((*ALONE, *SEVERAL, "none", "unknown"), lambda s: s.right),
    "right stage": ((*ALONE, *SEVERAL, "unknown"), lambda s: s.right_stage),
    "right stage, single": (("single",), lambda s: s.right_stage),
    **{f"{title}, {said}": ((kind,), hit) for kind, title in _TITLES.items() for said, hit in _SAID.items()},
    "single, named first": (("single",), lambda s: s.first_right),
    "two or three, at least one": (SEVERAL, lambda s: any(name in s.causes for name in s.names)),
    "known, a wrong name beside": (
        (*ALONE, *SEVERAL),
        lambda s: any(answer_set(effect).isdisjoint(s.causes) for effect in s.effects),
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
    """Every measure, calibration, coverage, and the wrong answers; JSON types only."""
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


def by_cause(cases: Sequence[Scored]) -> dict[str, dict[str, float | int | None]]:
    """Lone causes -> how often the answer was right; ` (removed)`: out of the model file, ` (half)`: weak."""
    hits: dict[str, list[bool]] = {}
    for case in cases:
        if case.kind in (*ALONE, "unknown"):
            name = case.causes[0] + (" (removed)" if case.removed[0] else " (half)" if case.kind == "half" else "")
            hits.setdefault(name, []).append(case.right)
    return {name: share(hits[name]) for name in sorted(hits)}


def calibration(cases: Sequence[Scored]) -> dict[str, Any]:
    """Confidence against how often it was right, every named effect that has one in ten bins of equal width.

    Right: the effect, or one of its equivalents, is a cause. ECE: mean distance of the two, bins weighted by size.
    """
    pairs = [
        (effect.confidence, not answer_set(effect).isdisjoint(case.causes))
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
    """How often a 95 % interval of the shrink holds what fresh trials show.

    An effect's interval is conditional on the others, so those count that are alone in their stage; for `chain`,
    those that are alone. `width`: of an interval, the median; `bias`: measured less said, the mean.
    """
    stage, chain = [], []
    for case in cases:
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
    for name, pairs in (("stage", stage), ("chain", chain)):
        widths = sorted(interval.high - interval.low for interval, _ in pairs)
        found[name] = {
            **share(interval.low <= value <= interval.high for interval, value in pairs),
            "width": widths[len(widths) // 2] if widths else None,
            "bias": sum(value - interval.value for interval, value in pairs) / len(pairs) if pairs else None,
        }
    return found


def wrong(case: Scored) -> dict[str, Any]:
    """A wrong answer beside the truth."""
    return {
        "case": case.case,
        "kind": case.kind,
        "causes": [n + (" (removed)" if r else "") for n, r in zip(case.causes, case.removed, strict=True)],
        "verdict": case.verdict.verdict if case.verdict else f"failed: {case.failure}",
        "stage": case.verdict.where.stage if case.verdict else None,
        "named": [
            {"name": e.name, "equivalents": list(e.equivalents), "confidence": e.confidence} for e in case.effects
        ],
    }
