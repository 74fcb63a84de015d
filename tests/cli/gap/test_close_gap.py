"""Tests of `softarm close-gap` with a stand-in for the diagnosis."""

import json

import pytest

from softarm.diagnosis.engine.result import Diagnosis
from softarm.evaluation.closing import fly
from softarm.schemas.flights import TEST_TARGETS
from softarm.schemas.model import Model
from tests.cli.invoke import invoke
from tests.diagnosis.verdicts import gap, rms, verdict

EASY = TEST_TARGETS[4]  # (-0.20, 0.55)
QUIET = rms("kPa", pressure=0.1)
NONE = verdict("none", gaps=gap(QUIET, QUIET, QUIET))


@pytest.mark.parametrize("declared", [True, pytest.param(False, marks=pytest.mark.prove)])
def test_the_result_shows_the_ways_and_the_written_files(campaign, tmp_path, monkeypatch, declared):
    without_a_gap = Diagnosis(NONE, Model(), None, (("a", "seed", 1.0),))
    monkeypatch.setattr("softarm.diagnosis.diagnose.diagnose", lambda *_, **__: without_a_gap)
    monkeypatch.setattr(fly, "TEST_TARGETS", (EASY,))
    monkeypatch.setattr(fly, "cores", lambda: 1)
    monkeypatch.setattr("softarm.cli.gap.close_gap.QUICK", fly.PART)
    own = ["--robot", "no-delay"] if declared else []
    outcome = invoke("close-gap", campaign, "--out", tmp_path / "out", "--policy", "reach", "--quick", *own)
    assert outcome.exit_code == 3, outcome.output  # keep the old one: the other one is as good
    place = "the held-out robot (no-delay)" if declared else "the nominal simulator"
    for words in ("old policy", "adaptive policy", f"flights on {place}", "No effect was named"):
        assert words in outcome.output
    assert f"wrote verdict.json, report.html, summary.json, limits-patch.yaml to {tmp_path / 'out'}" in outcome.output
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["spent"].keys() == {"diagnose", "old", "adaptive"}
    assert summary["judged_on"] == place
