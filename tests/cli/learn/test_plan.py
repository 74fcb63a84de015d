"""Tests of `softarm dev plan`."""

import json

import numpy as np

from softarm.policies.plans import Plans
from softarm.training.trajectory import ceiling
from tests.cli.invoke import succeed


def test_plan_writes_plans_and_results(monkeypatch, tmp_path):
    # As many first guesses as this target needs.
    monkeypatch.setattr("softarm.training.trajectory.planner.LIBRARY", 512)
    monkeypatch.setattr("softarm.training.trajectory.planner.TRIES", 1)
    out, results = tmp_path / "deep/mine.npz", tmp_path / "mine.json"
    result = succeed("dev", "plan", "--target", -0.2, 0.6, "--start", 0, "--out", out, "--json", results)
    plans = Plans.load(out)
    np.testing.assert_allclose(plans.target_m, [[-0.2, 0.6]], atol=1e-6)
    assert plans.model == "seed"
    assert '"reached": true' in results.read_text()
    assert str(out) in result.output.replace("\n", "")


def test_needs_prints_and_writes_what_reaches_a_missed_target(monkeypatch, tmp_path):
    values = dict.fromkeys(ceiling.QUANTITIES) | {"rail half-length": 0.33}
    need = ceiling.Need(np.float32([0.0, 0.75]), 0.1, values, 0.09)
    monkeypatch.setattr(ceiling, "of_missed", lambda *_: [need])
    results = tmp_path / "needs.json"
    result = succeed("dev", "plan", "--needs", "--json", results)
    for words in ("0.00, 0.75", "rail half-length (m), now 0.25", "0.33", "not by 36"):
        assert words in result.output
    assert json.loads(results.read_text())["rows"][0]["values"] == values
