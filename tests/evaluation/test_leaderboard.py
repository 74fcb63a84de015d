"""Leaderboard: entries are added once, then reproduced."""

import json
import shutil
from pathlib import Path

import pytest

from softarm.common.shares import share
from softarm.evaluation import leaderboard, table
from softarm.evaluation.leaderboard import Board, Row
from softarm.evaluation.table import Score
from softarm.policies.onnx_policy import MODELS
from tests.cli.invoke import invoke

STORED = Path(__file__).parents[2] / "benchmarks" / "leaderboard.json"


def run(*arguments):
    return invoke("evaluate", *arguments)


@pytest.fixture
def reached(monkeypatch):
    """Let as many flights of every job reach their target as the list's only element says."""
    number = [20]
    monkeypatch.setattr(table, "measure", lambda job, config=None: [Score(k < number[0]) for k in range(len(job.part))])
    return number


def test_an_entry_is_added_then_reproduced_under_any_name(reached, monkeypatch, tmp_path):
    monkeypatch.setattr("sys.argv", ["/bin/softarm", "evaluate", "reach", "pid"])
    board, mine = tmp_path / "board.json", tmp_path / "mine.onnx"
    shutil.copy(MODELS / "reach.onnx", mine)
    added = run("reach", "pid", "--leaderboard", board, "--workers", 1)
    assert (added.exit_code, "reach: added\npid: added" in added.output) == (0, True), added.output
    (entry, pid) = json.loads(board.read_text())["entries"]
    assert (entry["name"], pid["sha256"], entry["results"]["all"]["of"]) == ("reach", [], 162)
    assert entry["command"] == "softarm evaluate reach pid"
    before = board.read_bytes()
    again = run(mine, "--leaderboard", board, "--workers", 1)
    assert "mine: reproduced, flight count by flight count" in again.output
    reached[0] = 3
    failed = run(mine, "--leaderboard", board, "--workers", 1)
    assert failed.exit_code == 1
    assert "mine: NOT reproduced" in failed.output
    assert "all 18 of 162, entry 120 of 162" in failed.output
    assert board.read_bytes() == before


def row(name, hits, sha256=()):
    results = {"all": share([True] * hits + [False] * (162 - hits))}
    return Row(name=name, sha256=sha256, seeds=(), results=results, date="2026-01-01", revision="a" * 40, command="c")


def test_the_best_policy_is_first_and_a_near_result_counts_as_reproduced():
    board, _, _ = leaderboard.merged(Board(), [row("low", 10), row("high", 150, ("ab",))])
    assert [each.name for each in board.entries] == ["high", "low"]
    same, sentences, reproduced = leaderboard.merged(board, [row("other", 148, ("ab",))])
    assert (same, sentences, reproduced) == (board, ["other: reproduced within the entry's intervals"], True)


def test_a_file_with_the_name_of_a_plug_in_is_another_policy():
    board, _, _ = leaderboard.merged(Board(), [row("pid", 10)])
    both, sentences, _ = leaderboard.merged(board, [row("pid", 150, ("ab",))])
    assert (len(both.entries), sentences) == (2, ["pid: added"])


def test_names_with_a_dot_are_kept_whole():
    names = ("lean-0.1", "lean-0.2", "/home/me/mine.onnx")
    flown = {"policies": {name: {} for name in names}, "seeds": dict.fromkeys(names, ())}
    assert [each.name for each in leaderboard.rows(flown, [], "c")] == ["lean-0.1", "lean-0.2", "mine"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--model", "no-delay"), "--leaderboard holds results of the seed's simulator: omit --model"),
        (("--config", "slow.yaml"), "--leaderboard: results need the default limits and goals"),
        ((), "board.json: is no leaderboard"),
    ],
)
def test_results_that_cannot_be_compared_are_refused(reached, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    Path("slow.yaml").write_text("limits: {rail: {velocity_max_m_s: 0.02}}\n")
    Path("board.json").write_text("{}" if arguments else "no json")
    outcome = run("pid", "--leaderboard", "board.json", *arguments)
    assert outcome.exit_code in (1, 2)
    assert words in outcome.output


@pytest.mark.prove
def test_a_stored_entry_is_reproduced(tmp_path):
    copy = tmp_path / "board.json"
    shutil.copy(STORED, copy)
    outcome = run("pid", "--leaderboard", copy, "--workers", 1)
    assert (outcome.exit_code, "pid: reproduced" in outcome.output) == (0, True), outcome.output
