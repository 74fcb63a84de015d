"""`softarm evaluate --all`: one table, as JSON, Markdown and a page that needs nothing else."""

import json
import re

import numpy as np
import pytest
from click.testing import CliRunner

from softarm.cli.main import main
from softarm.flights import page
from softarm.policies.base import MODELS
from softarm.training.trajectory import ceiling


def run(*arguments):
    return CliRunner().invoke(main, ["evaluate", *map(str, arguments)], prog_name="softarm")


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A sweep's folder with two seeds of one name, as `softarm train --sweep` leaves it."""
    folder = tmp_path_factory.mktemp("runs")
    for seed, model in ((1, "reach"), (2, "reach-wide")):
        (folder / "mine" / f"seed-{seed}").mkdir(parents=True)
        (folder / "mine" / f"seed-{seed}" / "reach.onnx").symlink_to(MODELS / f"{model}.onnx")
    return folder


@pytest.mark.slow
def test_learned_policies_come_with_their_spread_beside_the_papers_figures(runs, tmp_path):
    page = tmp_path / "all.html"
    result = run(
        *("--all", "--runs", runs, "--only", "mine", "--only", "pid", "--test", "grid", "--workers", 1),
        *("--json", tmp_path / "all.json", "--report", page),
    )
    assert result.exit_code == 0, result.output
    table = json.loads((tmp_path / "all.json").read_text())
    mine = table["policies"]["mine"]["all"]
    assert len(mine["values"]) == 2
    assert mine["mean"] == pytest.approx(np.mean(mine["values"]))
    assert mine["spread"] == pytest.approx(np.std(mine["values"], ddof=1))
    assert mine["mean"] > 0.8 > table["policies"]["pid"]["all"]["mean"]
    assert table["policies"]["pid"]["all"]["spread"] is None
    assert table["hardware"]["the paper's learned policy"]["all"] == 0.80
    assert [len(shares) for shares in table["reached"].values()] == [54, 54]
    text = page.read_text()
    assert "<svg" in text
    assert not re.search(r"https?:", text)  # nothing is fetched
    for words in ("mine", "pid", "the paper&#x27;s PID"):
        assert words in text
        assert words.replace("&#x27;", "'") in result.output


def test_the_ceiling_is_a_row_of_the_table_and_a_map(monkeypatch, tmp_path):
    monkeypatch.setattr(ceiling, "ROUNDS", 2)
    monkeypatch.setattr(ceiling, "POPULATION", 24)
    result = run("--all", "--only", "ceiling", "--test", "grid", "--workers", 1, "--json", tmp_path / "all.json")
    assert result.exit_code == 0, result.output
    written = json.loads((tmp_path / "all.json").read_text())
    assert list(written["policies"]["ceiling"]) == ["in_range", "above", "all"]
    assert 0.0 < written["policies"]["ceiling"]["all"]["mean"] < 1.0
    assert len(written["reached"]["ceiling"]) == 54
    assert "| ceiling (open-loop search) |  |" in result.output
    assert "<figcaption><b>ceiling (open-loop search)</b>" in page.html(written, "")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--all", "--test", "fly"), "no test 'fly'"),
        (("--all", "--test", "held_back@no-delay"), "takes no model"),
        (("--all", "--test", "grid@no-dely"), "did you mean no-delay"),
        (("--all", "--only", "nobody"), "no policy nobody"),
    ],
)
def test_what_there_is_not_is_said(arguments, words):
    result = run(*arguments)
    assert result.exit_code == 1
    assert words in result.output


def test_options_of_the_table_go_with_it():
    assert run("--test", "grid").exit_code == 2
    assert run("--matrix").exit_code == 2
