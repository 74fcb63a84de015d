"""`softarm plan`: it plans, shows and writes a file that loads, and says what is wrong."""

import numpy as np
import pytest
from click.testing import CliRunner

from softarm.cli.main import main
from softarm.policies.plans import Plans
from softarm.training.trajectory import ceiling


@pytest.fixture
def small(monkeypatch):
    """Fewer first guesses and iterations than shipped: enough for these targets."""
    monkeypatch.setattr("softarm.training.trajectory.optimiser.OUTER", 5)
    monkeypatch.setattr("softarm.training.trajectory.planner.LIBRARY", 512)
    monkeypatch.setattr("softarm.training.trajectory.planner.EACH", 1)


def test_the_verb_plans_shows_and_writes_a_file_that_loads(small, tmp_path):
    out, told = tmp_path / "deep/mine.npz", tmp_path / "mine.json"
    arguments = ["plan", "--target", "-0.2", "0.6", "--start", "0", "--out", str(out), "--json", str(told)]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 0, result.output
    plans = Plans.load(out)
    np.testing.assert_allclose(plans.target_m, [[-0.2, 0.6]], atol=1e-6)
    assert plans.model == "seed"
    assert '"reached": true' in told.read_text()
    assert str(out) in result.output.replace("\n", "")


def test_the_verb_says_what_is_wrong():
    result = CliRunner().invoke(main, ["plan", "--start", "0.3"])
    assert result.exit_code == 2
    assert "0.3 is not in the range" in result.output
    result = CliRunner().invoke(main, ["plan", "--model", "nothing.yaml"])
    assert result.exit_code == 1
    assert "nothing.yaml" in result.output


def test_the_ceiling_of_all_targets_is_told_by_their_height(monkeypatch, tmp_path):
    monkeypatch.setattr(ceiling, "ROUNDS", 2)
    monkeypatch.setattr(ceiling, "POPULATION", 24)
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(main, ["plan", "--ceiling", "--start", "0"])
    assert result.exit_code == 0, result.output
    for words in ("z <= 0.70 m", "z > 0.70 m", "54 searched in", "missed from a start or more: ("):
        assert words in result.output
    assert list(tmp_path.iterdir()) == []  # a search writes no plans
