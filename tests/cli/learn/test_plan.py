"""Tests of `softarm dev plan`."""

import json

import numpy as np
import pytest

from softarm.cli.dev import show
from softarm.policies.plans import Plans
from softarm.training.trajectory import ceiling
from tests.cli.invoke import invoke


@pytest.fixture
def small(monkeypatch):
    """Reduce first guesses to the number that these targets need."""
    monkeypatch.setattr("softarm.training.trajectory.planner.LIBRARY", 512)
    monkeypatch.setattr("softarm.training.trajectory.planner.TRIES", 1)


def test_plan_writes_plans_and_results(small, tmp_path):
    out, results = tmp_path / "deep/mine.npz", tmp_path / "mine.json"
    arguments = ["dev", "plan", "--target", "-0.2", "0.6", "--start", "0", "--out", str(out), "--json", str(results)]
    result = invoke(*arguments)
    assert result.exit_code == 0, result.output
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
    result = invoke("dev", "plan", "--needs", "--json", str(results))
    assert result.exit_code == 0, result.output
    for words in ("0.00, 0.75", "rail half-length (m), now 0.25", "0.33", "not by 36"):
        assert words in result.output
    assert json.loads(results.read_text())["rows"][0]["values"] == values


def test_many_plans_are_printed_by_height_with_the_missed_targets(capsys):
    reached = {"y": -0.2, "z": 0.6, "start": 0.0, "planned": True, "planned_miss_m": 0.0, "miss_m": 0.01}
    reached |= {"reached": True, "time_s": 1.5}
    missed = reached | {"z": 0.75, "planned": False, "reached": False, "time_s": None}
    show([reached] * 12 + [missed] * 4)
    lines = [line.split("│") for line in capsys.readouterr().out.splitlines()]
    rows = {cells[1].strip(): [cell.strip() for cell in cells[2:6]] for cells in lines if len(cells) > 5}
    assert rows["z <= 0.70 m"] == ["12", "100.0 %", "100.0 %", "1.50 on average"]
    assert rows["z > 0.70 m"] == ["4", "0.0 %", "0.0 %", "-"]
    assert lines[-1] == ["missed from at least one start: (-0.20, 0.75)"]
