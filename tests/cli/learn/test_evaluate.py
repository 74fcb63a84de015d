"""Tests of `softarm evaluate`."""

import json
import re

import numpy as np
import pytest

from softarm.evaluation import runner, table, tests
from softarm.policies.base import MODELS
from softarm.schemas import flights
from tests.cli.invoke import refuse, succeed


def run(*arguments):
    return succeed("evaluate", *arguments)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Return a sweep's folder with two seeds of one name, as `softarm train --sweep` writes it."""
    folder = tmp_path_factory.mktemp("runs")
    for seed, model in ((1, "reach"), (2, "reach-wide")):
        (folder / "mine" / f"seed-{seed}").mkdir(parents=True)
        (folder / "mine" / f"seed-{seed}" / "reach.onnx").symlink_to(MODELS / f"{model}.onnx")
    return folder


def test_trained_policies_are_shown_with_their_spread_and_the_papers_results(runs, tmp_path, monkeypatch):
    """With invented results: the flights themselves are those of tests/evaluation."""

    def measure(job, config=None):
        every = {None: 6, 1: 1.1, 2: 1.05}[job.entry.seed]  # of these trials one, of pid's, or all but a few
        return [table.Score(trial % every < 1) for trial in job.part]

    monkeypatch.setattr(table, "measure", measure)
    page = tmp_path / "all.html"
    result = run(
        *("--all", "--runs", runs, "--only", "mine", "--only", "pid", "--test", "grid", "--workers", 1),
        *("--json", tmp_path / "all.json", "--report", page),
    )
    shown = json.loads((tmp_path / "all.json").read_text())
    mine = shown["policies"]["mine"]["all"]
    assert len(mine["values"]) == 2
    assert len(shown["closest_m"]["mine"][0]) == 6
    assert mine["mean"] == pytest.approx(np.mean(mine["values"]))
    assert mine["spread"] == pytest.approx(np.std(mine["values"], ddof=1))
    assert mine["mean"] > 0.8 > shown["policies"]["pid"]["all"]["mean"]
    assert shown["policies"]["pid"]["all"]["spread"] is None
    assert shown["hardware"]["the paper's learned policy"]["all"] == 0.80
    assert [len(shares) for shares in shown["reached"].values()] == [54, 54]
    text = page.read_text()
    assert "<svg" in text
    assert not re.search(r"https?:", text)
    assert "mean and standard deviation over seeds" in text
    for words in ("mine", "pid", "the paper&#x27;s PID"):
        assert words in text
        assert words.replace("&#x27;", "'") in result.output


@pytest.fixture
def configured(tmp_path):
    """Return a configuration with a policy of its own and a cart that hardly moves."""
    file = tmp_path / "mine.yaml"
    file.write_text(
        f"policies: {{my-reach: {{plugin: onnx, options: {{model: {MODELS / 'reach.onnx'}}}}}}}\n"
        "limits: {rail: {velocity_max_m_s: 0.02}}\n"
    )
    return file


@pytest.mark.slow
def test_trained_and_configured_policies_are_compared_with_shipped_ones(configured, tmp_path, monkeypatch):
    few = flights.shelf()[::6]
    monkeypatch.setitem(tests.TESTS, "shelf", tests.Test("", lambda: few))
    file = tmp_path / "trained.onnx"
    file.symlink_to(MODELS / "shelf.onnx")
    names = (str(file), "my-reach", "pid")
    run(
        *names,
        *("--config", configured, "--model", "no-delay", "--test", "shelf", "--workers", 1),
        *("--json", tmp_path / "all.json", "--report", tmp_path / "all.html"),
    )
    table = json.loads((tmp_path / "all.json").read_text())
    assert set(table["policies"]) == set(names)
    assert {tuple(row) for row in table["policies"].values()} == {("shelf@no-delay",)}
    # The configuration holds the cart, so no swing reaches the shelf.
    assert table["policies"][str(file)]["shelf@no-delay"]["mean"] == 0.0
    assert "standard deviation" not in (tmp_path / "all.html").read_text().split("<h1>")[1].split("<nav")[0]


def test_a_trained_file_is_evaluated_alone(monkeypatch):
    few = flights.grid()[::20]
    monkeypatch.setattr(flights, "grid", lambda: few)
    assert "x real time" in run(MODELS / "reach.onnx").output


def test_an_error_of_numpy_in_a_flight_is_a_defect(monkeypatch):
    def fly(*given):
        raise ValueError("operands could not be broadcast together")

    monkeypatch.setattr(runner, "evaluate", fly)
    refuse("a defect in softarm", "evaluate", "reach", code=70)


@pytest.fixture
def measured(monkeypatch):
    """Record the policy files and names that are flown, and let every flight fail."""
    flown = []

    def measure(job, config=None):
        flown.append((job.entry.name, job.test))
        return [table.Score(False)] * len(job.part)

    monkeypatch.setattr(table, "measure", measure)
    return flown


def test_files_and_folders_are_added_to_all_policies(runs, measured, tmp_path):
    folder = str(runs / "mine" / "seed-1")
    run("--all", folder, "--only", "pid", "--test", "shelf", "--workers", 1)
    assert measured == [(folder, "shelf"), ("pid", "shelf")]


def test_a_policy_that_cannot_be_used_is_refused_before_anything_flies(measured, tmp_path):
    (tmp_path / "damaged.onnx").write_text("no model")
    refuse("damaged.onnx", "evaluate", "pid", tmp_path / "damaged.onnx", "--workers", 1)
    assert measured == []


@pytest.mark.slow
def test_the_film_shows_the_policy(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    few = flights.grid()[::40]
    monkeypatch.setattr(flights, "grid", lambda: few)
    (tmp_path / "short.yaml").write_text("goals: {time_limit_s: 0.2}\n")
    monkeypatch.setattr("softarm.evaluation.film.AFTER_TICKS", 3)
    film = (MODELS / "shelf.onnx", "--film", "a.gif", "--target", -0.45, 0.6, "--config", "short.yaml")
    assert "shelf.onnx, target y -0.45, z 0.6 m" in run(*film).output
    assert (tmp_path / "a.gif").read_bytes().startswith(b"GIF89a")
