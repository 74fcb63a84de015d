"""Tests of `softarm dev plan`."""

import json

import numpy as np

from softarm.cli import dev
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


def test_many_plans_are_summed_up_by_height(capsys):
    near = {"y": -0.2, "z": 0.6, "planned": True, "reached": True, "time_s": 1.0}
    far = {"y": 0.1, "z": 0.8, "planned": False, "reached": False, "time_s": None}
    dev.show([near] * 9 + [near | {"time_s": 2.0}] * 3 + [far] * 4)
    printed = " ".join(capsys.readouterr().out.replace("\N{BOX DRAWINGS LIGHT VERTICAL}", " ").split())
    assert "z <= 0.70 m 12 100.0 % 100.0 % 1.25 on average z > 0.70 m 4 0.0 % 0.0 % - all 16 75.0 % 75.0 %" in printed
    assert "missed from at least one start: (0.10, 0.80)" in printed
    dev.show([near] * 13)
    assert "z > 0.70 m" not in capsys.readouterr().out


def test_needs_prints_and_writes_what_reaches_a_missed_target(monkeypatch, tmp_path):
    values = dict.fromkeys(ceiling.QUANTITIES) | {"rail half-length": 0.33}
    need = ceiling.Need(np.float32([0.0, 0.75]), 0.1, values, 0.09)
    monkeypatch.setattr(ceiling, "of_missed", lambda *_: [need])
    results = tmp_path / "needs.json"
    result = succeed("dev", "plan", "--needs", "--json", results)
    for words in ("0.00, 0.75", "rail half-length (m), now 0.25", "0.33", "not by 36"):
        assert words in result.output
    assert json.loads(results.read_text())["rows"][0]["values"] == values
