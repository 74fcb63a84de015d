"""Detection limits: strengths around the weakest cause, and the strength from which answers are right."""

import pytest

from validation.blind.imperfections import read
from validation.detection import SHARES, causes, limit, weak


def test_the_limit_is_the_smallest_strength_from_which_nine_of_ten_are_found():
    assert limit([(1.0, True), (0.5, True), (0.25, False)]) == 0.5
    assert limit([(2.0, False), (1.0, True)]) is None
    assert limit([]) is None
    found = [(float(s), s != 8) for s in range(1, 12)]  # one of eleven is missed
    assert limit(found) == 1.0


def test_every_weak_cause_is_within_its_shares_of_the_benchmarks_weakest():
    for k, (name, (first, *others)) in enumerate(causes()):
        drawn = [weak(k, name, (first, *others), i, 3) for i in range(3)]
        for case, share in drawn:
            assert SHARES[0] <= share <= SHARES[1]
            (cause,) = case.causes
            assert (cause.name, case.kind) == (name, "single")
            value = read(case.robot, first.path)
            assert value == cause.settings[first.path]
            changed = {"set": first.weakened(share), "add": None, "times": None}[first.how]
            assert changed is None or value in (pytest.approx(changed), pytest.approx(-changed))
        assert [share for _, share in drawn] == sorted(share for _, share in drawn)


def test_other_cases_have_other_names():
    cause = next(causes())
    names = [weak(0, *cause, 1, draws)[0].name for draws in (8, 6, 8)]
    assert names[0] != names[1]
    assert names[0] == names[2]
