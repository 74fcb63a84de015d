"""Measures of the sealed benchmark on small cases that are counted by hand."""

from dataclasses import replace

import pytest

from tests.diagnosis.verdicts import effect, verdict
from validation.blind.imperfections import Cause
from validation.blind.score import Scored, answer_set, calibration, coverage, score


def case(kind, causes, *effects, stated="named", stage=None, shrink=None):
    answer = verdict(stated if effects or stated != "named" else "none", *effects, stage=stage)
    return Scored("case", kind, tuple(Cause(name, False, {}) for name in causes), answer, "", shrink)


def measures(*cases):
    return {name: (cell["hits"], cell["of"]) for name, cell in score(cases)["measures"].items()}


def test_single_causes_are_counted_exact_or_in_sets_of_two():
    found = measures(
        case("single", ["rail.lag"], effect("rail.lag"), stage="rail"),
        case("single", ["rail.lag"], effect("rail.delay", "rail.lag"), stage="rail"),
        case("single", ["rail.lag"], effect("rail.delay", "rail.lag", "mocap.latency"), stage="rail"),
        case("single", ["rail.lag"], effect("rail.lag"), effect("arm.drag"), stage="arm"),
        case("single", ["rail.lag"], stage=None),
    )
    assert found["single, exact"] == (1, 5)
    assert found["single, exact or in sets of two"] == (2, 5)
    assert found["single, named first"] == (2, 5)
    assert found["right stage"] == found["right stage, single"] == (3, 5)


def test_two_causes_are_matched_in_any_order():
    causes = ["rail.lag", "arm.drag"]
    found = measures(
        case("two", causes, effect("arm.drag"), effect("rail.lag"), stage="arm"),
        case("two", causes, effect("arm.damping", "arm.drag"), effect("rail.lag"), stage="rail"),
        case("two", causes, effect("rail.lag", "arm.drag"), effect("rail.gain"), stage="rail"),
        case("two", causes, effect("rail.lag"), stage="mocap"),
    )
    assert found["two, exact"] == (1, 4)
    assert found["two, exact or in sets of two"] == (2, 4)
    assert found["two or three, at least one"] == (4, 4)
    assert found["right stage"] == (3, 4)


def test_names_without_a_cause_and_for_unknown_causes_are_counted():
    found = measures(
        case("none", [], stated="none"),
        case("none", [], effect("rail.lag"), stage="rail"),
        case("unknown", ["unknown.cable"], stated="unknown", stage="rail"),
        case("unknown", ["unknown.cable"], effect("rail.gain"), stated="incomplete", stage="rail"),
        case("unknown", ["unknown.cable"], effect("rail.gain"), stage="arm"),
        Scored("case", "unknown", (Cause("unknown.cable", False, {}),), None, "it fell"),
    )
    assert found["none, given a name"] == found["none, said so"] == (1, 2)
    assert found["unknown, given a name"] == (2, 4)
    assert found["unknown, given a name as the whole answer"] == found["unknown, said so"] == (1, 4)
    assert found["right stage"] == (2, 4)
    assert found["failed"] == (1, 6)


def test_the_calibration_error_is_weighted_by_bin_size():
    cases = [case("single", ["rail.lag"], effect("rail.lag", confidence=0.95))] * 3
    cases += [case("single", ["rail.lag"], effect("rail.gain", confidence=0.95))]
    cases += [case("single", ["rail.lag"], effect("rail.gain", "rail.lag", confidence=0.35))]
    found = calibration([*cases, case("none", [], effect("rail.gain", confidence=1.0))])
    # Of 0.95 (four) and 1.0 (one) 3 of 5 were right; of 0.35 the one.
    assert found["named"] == 6
    assert found["ece"] == pytest.approx((abs(4.8 - 3) + abs(0.35 - 1)) / 6)
    assert [b["of"] for b in found["bins"]] == [0, 0, 0, 1, 0, 0, 0, 0, 0, 5]
    assert answer_set(cases[-1].effects[0]) == {"rail.gain", "rail.lag"}
    assert calibration([case("none", [])])["ece"] is None


def test_coverage_counts_effects_alone_in_their_stage():
    chain = (0.2, 0.1, 0.3)
    fresh = {"rail": 0.5, "arm": 0.9, "chain": 0.35}
    found = coverage(
        [
            case("single", ["rail.lag"], effect("rail.lag", chain=chain), shrink=fresh),
            case("two", ["rail.lag", "arm.drag"], effect("rail.lag"), effect("arm.drag", chain=chain), shrink=fresh),
            case("two", ["rail.lag", "rail.gain"], effect("rail.lag"), effect("rail.gain"), shrink=fresh),
            case("single", ["rail.lag"], effect("rail.lag")),
        ]
    )
    assert (found["stage"]["hits"], found["stage"]["of"]) == (2, 3)
    assert (found["chain"]["hits"], found["chain"]["of"]) == (0, 1)
    assert found["chain"]["bias"] == pytest.approx(0.15)
    assert found["stage"]["width"] == pytest.approx(0.2)


def test_an_interval_of_a_size_holds_the_true_one_of_the_named_effect_alone():
    true = Cause("rail.gain", False, {"rail.feed_error": -0.05}), Cause("rail.lag", False, {"rail.lag_s": 0.02})
    inside = effect("rail.gain", scale=(-0.055, -0.06, -0.04, "-"))
    beside = effect("rail.lag", time=(0.03, 0.025, 0.035, "s"), other=(1.0, 0.9, 1.1, "-"))
    cases = [replace(case("two", ["rail.gain", "rail.lag"], inside, beside), causes=true)]
    found = coverage([*cases, case("single", ["rail.gain"], inside)])["size"]
    assert (found["hits"], found["of"]) == (1, 2)
    assert found["bias"] == pytest.approx(((1 - 1.1) + (1 - 1.5)) / 2)
