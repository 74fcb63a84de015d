"""Table of all policies in all tests, with the footnotes of its figures."""

import re

import numpy as np
import pytest

from softarm.common.batch import JobsFailed, Workers
from softarm.evaluation import entries, page, table, tests
from softarm.evaluation.entries import Entry
from softarm.evaluation.table import Job, Score
from softarm.policies.base import PolicyError
from softarm.policies.onnx_policy import OnnxPolicy
from softarm.schemas.config import Config, Failsafe
from softarm.training.trajectory import ceiling

pytestmark = pytest.mark.slow


def test_a_test_on_another_model_has_a_separate_column(monkeypatch):
    few = tests.TESTS["shelf"].scenarios()[:1]
    monkeypatch.setitem(tests.TESTS, "shelf", tests.Test("", lambda: few))
    found = entries.given(("pid",))
    result = table.compare(found, Workers(1), ("shelf@no-delay",))
    assert list(result["policies"]["pid"]) == ["shelf@no-delay"]
    assert "on no-delay" in page.markdown(result)


def test_every_shipped_policy_is_flown_and_the_ceiling_covers_the_grid_alone():
    found = entries.every()
    assert {"mppi", "pid", "reach", "reach-wide", "shelf", "trajectory", "ceiling"} <= {entry.name for entry in found}
    trained = OnnxPolicy("reach").metadata.seed
    assert [entry.seed for entry in found if entry.name in ("pid", "reach")] == [None, trained]
    todo = table.jobs(found, tuple(tests.TESTS))
    assert {job.test for job in todo if job.entry.name == "ceiling"} == {"grid"}
    for entry in found:
        for name, test in tests.TESTS.items():
            parts = [job.part for job in todo if (job.entry, job.test) == (entry, name)]
            if parts:  # each trial once
                assert sorted(number for part in parts for number in part) == list(range(len(test.scenarios())))


def test_the_ceiling_is_searched_from_the_start_of_each_trial(monkeypatch):
    asked = []

    def search(targets_m, start_m, model):
        asked.append(start_m)
        return ceiling.Ceiling(np.full(54, start_m), np.where(targets_m[:, 1] < 0.6, start_m, np.nan))

    monkeypatch.setattr(ceiling, "search", search)
    result = table.compare([Entry("ceiling")], Workers(1), ("grid",))
    assert asked == [0.0, 0.1, 0.2]
    assert result["reached"]["ceiling"] == [1.0] * 9 + [0.0] * 45
    assert result["closest_m"]["ceiling"] == [[0.0, 0.1, 0.2]] * 54
    assert result["policies"]["ceiling"]["in_range"]["mean"] == pytest.approx(9 / 36)


def test_refused_trials_are_noted_and_a_fully_refused_test_is_no_zero(monkeypatch):
    every = tests.TESTS["swinging"].scenarios()[::18]
    monkeypatch.setitem(tests.TESTS, "swinging", tests.Test("", lambda: every))
    swinging = [Job(Entry("trajectory"), "swinging", range(9)), Job(Entry("trajectory"), "shelf", range(12))]
    result = table.summary({job: table.measure(job) for job in swinging})
    figures, notes = result["policies"]["trajectory"], result["notes"]["trajectory"]
    assert 0.5 < figures["swinging"]["refused"] < 1.0
    assert figures["swinging"]["mean"] <= 1.0 - figures["swinging"]["refused"]
    refused = round(9 * figures["swinging"]["refused"])
    assert notes["swinging"] == [
        f"refused {refused} of 9 trials, which count as not reached; the first: no plan from here"
    ]
    assert figures["shelf"]["refused"] == 1.0
    row, *_ = (line for line in page.markdown(result).splitlines() if line.startswith("| trajectory"))
    mid_swing, shelf = (cell.strip() for cell in row.split("|")[3:5])
    assert mid_swing == f"{100 * figures['swinging']['mean']:.1f} [1]"
    assert shelf == "- [2]"
    assert "<sup>1</sup>" in page.html(result, "")


def test_a_figure_outside_the_training_range_has_a_note():
    found = entries.given(("reach", "reach-wide", "pid"))
    missed = [Score(False)] * 162
    result = table.summary({Job(entry, "grid", range(162)): missed for entry in found})
    assert result["notes"] == {"pid": {}, "reach": {"above": [table.OUTSIDE]}, "reach-wide": {}}
    assert page.footnotes(result) == [table.OUTSIDE]
    assert "Seeds: " in page.markdown(result)
    assert "mppi" not in page.markdown(result)
    assert "Ceiling: " not in page.markdown(result)


@pytest.mark.parametrize("processes", [1, pytest.param(2, marks=pytest.mark.prove)])
def test_the_size_of_jobs_and_the_number_of_processes_do_not_change_the_table(monkeypatch, processes):
    found, few = entries.given(("pid", "shelf")), tests.TESTS["shelf"].scenarios()[::6]
    monkeypatch.setitem(tests.TESTS, "shelf", tests.Test("", lambda: few))
    alone = table.compare(found, Workers(1), ("shelf",))
    monkeypatch.setattr(table, "PART", 1)
    assert table.compare(found, Workers(processes), ("shelf",)) == alone
    assert alone["policies"]["shelf"]["shelf"]["mean"] > 0.5 > alone["policies"]["pid"]["shelf"]["mean"]


def test_a_restarted_comparison_flies_the_missing_and_the_changed_jobs(monkeypatch, tmp_path):
    flown = []

    def measure(job, config=None):
        if job.part.start and not flown[1:]:
            raise PolicyError("cannot fly now")
        flown.append((job.entry.name, job.part.start))
        return [Score(job.entry.name == "mine", closest_m=0.1)] * len(job.part)

    monkeypatch.setattr(table, "measure", measure)
    monkeypatch.setattr(table, "PART", 6)
    mine = tmp_path / "mine.onnx"
    mine.write_bytes(b"one")
    found = [Entry("mine", file=mine), Entry("pid")]
    with pytest.raises(JobsFailed, match=r"pid, shelf, flights 6 to 11: PolicyError: cannot fly now"):
        table.compare(found[1:], Workers(1), ("shelf",), keep=tmp_path / "kept")
    whole = table.compare(found, Workers(1), ("shelf",), keep=tmp_path / "kept")
    assert flown == [("pid", 0), ("mine", 0), ("mine", 6), ("pid", 6)]
    assert table.compare(found, Workers(1), ("shelf",), keep=tmp_path / "kept") == whole
    assert len(flown) == 4
    assert whole["policies"]["mine"]["shelf"]["mean"] == 1.0
    mine.write_bytes(b"two")
    table.compare(found, Workers(1), ("shelf",), keep=tmp_path / "kept")
    assert flown[4:] == [("mine", 0), ("mine", 6)]
    table.compare(found, Workers(1), ("shelf",), Config(failsafe=Failsafe(rail_stale_s=0.2)), tmp_path / "kept")
    assert len(flown) == 10


def test_maps_show_the_first_test_that_flies_the_54_targets():
    def flown(test, reached, trials):
        return {Job(Entry("pid"), test, range(trials)): [Score(reached, closest_m=0.05)] * trials}

    result = table.summary(flown("shelf", True, 12) | flown("swinging", False, 162) | flown("grid", True, 162))
    assert result["mapped"] == "54 from mid-swing"
    assert result["reached"] == {"pid": [0.0] * 54}
    assert result["closest_m"] == {"pid": [[0.05] * 3] * 54}
    assert table.summary(flown("grid@no-delay", True, 162))["mapped"] == "all 54, on no-delay"
    alone = table.summary(flown("shelf", True, 12))
    assert alone["mapped"] == ""
    assert "The 54 targets" not in page.html(alone, "")


def test_maps_stand_side_by_side_with_the_closest_distances():
    scores = [Score(trial % 3 == 0, closest_m=0.03 + 0.01 * (trial % 3)) for trial in range(162)]
    unseen = [Score(False)] * 162
    result = table.summary(
        {Job(Entry("pid"), "grid", range(162)): scores, Job(Entry("bad"), "grid", range(162)): unseen}
    )
    drawn = page.html(result, "softarm evaluate pid bad")
    assert drawn.count("<figure>") == 2
    assert drawn.count("y -0.40, z 0.55 m: reached in 1 of 3 flights; closest distance 30, 40, 50 mm") == 1
    assert drawn.count("y -0.40, z 0.55 m: reached in 0 of 3 flights") == 1
    assert drawn.count("not known") == 54
    assert not re.search(r"https?:", drawn)
