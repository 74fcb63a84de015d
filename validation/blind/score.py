"""Scoring of answers about the soft arm: shares, calibration, coverage and a list of the wrong answers.

The page docs/evidence/blind.md defines the measures.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Any

from softarm.common.shares import share
from softarm.schemas.verdict import Interval, NamedEffect, Verdict
from validation.blind.imperfections import SAME_SIZE, Cause

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
        "calibration": calibration(cases),
        "coverage": coverage(cases),
        "wrong": [wrong(case) for case in cases if not case.right],
    }


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
