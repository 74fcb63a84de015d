"""Detection limits: strengths around the weakest cause, and the strength from which answers are right."""

import numpy as np
import pytest

from softarm.common.batch import Workers
from softarm.diagnosis.blind import detection, pages
from softarm.diagnosis.blind.detection import SHARES, causes, healthy, limit, weak
from softarm.diagnosis.blind.imperfections import KNOWN, read


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


@pytest.mark.parametrize(("name", "weaker"), [("pressure.lag", 1.2**0.5), ("pressure.ceiling", 35.0)])
def test_half_the_strength_is_half_a_logarithm_of_a_factor_and_twice_a_limit(name, weaker):
    assert KNOWN[name][0][0].weakened(0.5) == pytest.approx(weaker)


def test_a_case_is_the_same_in_every_run():
    name, variant = next(causes())
    assert weak(0, name, variant, 1, 2) == weak(0, name, variant, 1, 2)
    assert healthy(2) == healthy(2) != healthy(3)


@pytest.mark.prove
def test_limits_and_false_names_are_measured_and_kept(tmp_path, monkeypatch):
    one = [(name, variant) for name, variant in causes() if name == "mocap.scale"]
    monkeypatch.setattr(detection, "causes", lambda: iter(one))
    found = detection.measure(tmp_path, 2, 1, Workers(1))
    assert found["causes"][0]["cause"] == "mocap.scale"
    assert found["healthy named"] == 0
    assert "0 of 1 healthy robots" in pages.detection(found)
    before = {file: file.stat().st_mtime_ns for file in (tmp_path / "answers").iterdir()}
    assert len(before) == 3
    assert detection.measure(tmp_path, 2, 1, Workers(1)) == found
    assert {file: file.stat().st_mtime_ns for file in (tmp_path / "answers").iterdir()} == before
    assert np.isfinite(found["causes"][0]["found"] or 0.0)
