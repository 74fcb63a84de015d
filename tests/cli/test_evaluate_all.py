"""`softarm evaluate --all`: one table, as JSON, Markdown and a page that needs nothing else."""

import json
import re

import numpy as np
import pytest
from click.testing import CliRunner

from softarm.cli.main import main
from softarm.flights import page, table, tests
from softarm.flights import runner as trials
from softarm.flights.robots import ROBOTS
from softarm.flights.runner import Outcome, Trial
from softarm.flights.table import Entry, Job
from softarm.policies import registry
from softarm.policies.base import MODELS
from softarm.policies.onnx_policy import OnnxPolicy
from softarm.policies.pid import Pid
from softarm.schemas.goals import Goal
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


def test_a_test_on_another_model_gets_a_column_of_its_own():
    found = table.entries(None, ("pid",))
    result = table.compare(found, 1, ("shelf@no-delay",))
    assert list(result["policies"]["pid"]) == ["shelf@no-delay"]
    assert "on no-delay" in page.markdown(result)


def test_every_shipped_policy_is_flown_and_the_ceiling_is_searched_for_the_grid_alone():
    found = table.entries(None)
    assert {"mppi", "pid", "reach", "reach-wide", "shelf", "trajectory", "ceiling"} <= {entry.name for entry in found}
    trained = OnnxPolicy("reach").metadata.seed
    assert [entry.seed for entry in found if entry.name in ("pid", "reach")] == [None, trained]
    todo = table.jobs(found, tuple(tests.TESTS))
    assert {job.test for job in todo if job.entry.name == "ceiling"} == {"grid"}
    for entry in found:
        for name, test in tests.TESTS.items():
            parts = [job.part for job in todo if (job.entry, job.test) == (entry, name)]
            if parts:  # each trial once
                assert sorted(number for part in parts for number in part) == list(range(len(test.make())))


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


def test_the_ceilings_trials_are_searched_from_their_own_starts(monkeypatch):
    asked = []

    def search(targets_m, start_m, model):
        asked.append(start_m)
        return ceiling.Ceiling(np.zeros(54), np.where(targets_m[:, 1] < 0.6, start_m, np.nan))

    monkeypatch.setattr(ceiling, "search", search)
    result = table.compare([Entry("ceiling")], 1, ("grid",))
    assert asked == [0.0, 0.1, 0.2]
    assert result["reached"]["ceiling"] == [1.0] * 9 + [0.0] * 45
    assert result["policies"]["ceiling"]["in_range"]["mean"] == pytest.approx(9 / 36)


def test_what_a_policy_refuses_is_said_and_a_test_that_it_refuses_altogether_is_no_zero():
    swinging = [Job(Entry("trajectory"), "swinging", range(162)), Job(Entry("trajectory"), "shelf", range(12))]
    result = table.summary({job: table.measure(job) for job in swinging})
    figures, notes = result["policies"]["trajectory"], result["notes"]["trajectory"]
    assert 0.5 < figures["swinging"]["refused"] < 1.0
    assert figures["swinging"]["mean"] <= 1.0 - figures["swinging"]["refused"]
    refused = round(162 * figures["swinging"]["refused"])
    assert notes["swinging"] == [
        f"refused {refused} of 162 trials, which count as not reached; the first: no plan from here"
    ]
    assert figures["shelf"]["refused"] == 1.0
    row, *_ = (line for line in page.markdown(result).splitlines() if line.startswith("| trajectory"))
    mid_swing, shelf = (cell.strip() for cell in row.split("|")[3:5])
    assert mid_swing == f"{100 * figures['swinging']['mean']:.1f} [1]"
    assert shelf == "- [2]"
    assert "<sup>1</sup>" in page.html(result, "")


def test_a_figure_beyond_what_a_policy_was_trained_for_says_so():
    entries = {entry.name: entry for entry in table.entries(None, ("reach", "reach-wide", "pid"))}
    missed = [Outcome(False)] * 162
    result = table.summary({Job(entry, "grid", range(162)): missed for entry in entries.values()})
    assert result["notes"] == {"pid": {}, "reach": {"above": [table.OUTSIDE]}, "reach-wide": {}}
    assert page.footnotes(result) == [table.OUTSIDE]


def test_parts_flown_by_other_processes_make_the_same_table(monkeypatch):
    monkeypatch.setattr(table, "PART", 5)
    found = table.entries(None, ("pid", "shelf"))
    done = []
    alone = table.compare(found, 1, ("shelf",))
    assert table.compare(found, 2, ("shelf",), done.append) == alone
    assert sorted(done) == [2, 2, 5, 5, 5, 5]
    assert alone["policies"]["shelf"]["shelf"]["mean"] > 0.5 > alone["policies"]["pid"]["shelf"]["mean"]


def test_a_planner_flies_the_robot_that_its_model_does_not_know():
    trial = Trial(Goal("reach", -0.2, 0.6), 0.1)
    assert trials.fly_held_back(registry.load("mppi"), ROBOTS["nominal"], [trial]) == [Outcome(True)]


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


def test_the_paper_swings_into_twelve_shelves_and_the_random_ones_lie_in_its_training_range():
    twelve = trials.shelf_trials()
    assert len(twelve) == 12
    assert {(trial.goal.y_m, trial.goal.z_m) for trial in twelve} == {
        (-0.48, 0.6),
        (-0.48, 0.63),
        (-0.48, 0.66),
        (-0.53, 0.63),
    }
    assert trials.random_shelf_trials() == trials.random_shelf_trials()
    for trial in trials.random_shelf_trials():
        assert -0.48 <= trial.goal.y_m <= -0.40
        assert 0.58 <= trial.goal.z_m <= 0.67
        assert -0.05 <= trial.depth_m <= 0.20
        assert -0.025 <= trial.cart_start_m <= 0.24


def test_a_policy_that_asks_for_the_depth_is_told_and_the_shelf_is_in_the_way():
    told = []

    class Deep(Pid):
        target_depth_m = 0.0

        def step(self, observation, goal):
            told.append(self.target_depth_m)
            return super().step(observation, goal)

    at_shelf = Trial(Goal("reach", -0.45, 0.6), 0.1, depth_m=0.07)
    assert trials.fly(Deep(), None, [at_shelf]) == [Outcome(False)]
    assert set(told) == {0.07}
    told.clear()
    trials.fly(Deep(), None, [Trial(Goal("reach", -0.45, 0.6), 0.1)])
    assert set(told) == {trials.MIDDLE_M}  # not what the last trial left


def test_goals_come_in_mid_swing_at_the_same_states_for_every_policy():
    begun = {}

    class Sees:
        def __init__(self, name):
            self.spec, self.seen = registry.load("pid").spec, begun.setdefault(name, [])

        def reset(self):
            self.fresh = True

        def step(self, observation, goal):
            if self.fresh:
                self.seen.append(np.array(observation))
            self.fresh = False
            return np.array([0.0 if self.seen is begun.get("one") else 1.0, 0.0], np.float32)

    for name in ("one", "two"):
        for trial in trials.swinging_trials()[:4]:
            daemon = trials.swing(Sees(name), None, trial)
            daemon.tick(daemon.request("goal", trial.goal))
    assert np.array_equal(begun["one"], begun["two"])
    assert len(begun["one"]) == 4
    speeds = np.linalg.norm(np.array(begun["one"])[:, 4:6], axis=1)
    assert speeds.max() > 0.3  # of the tip: it swings
    assert np.ptp(np.array(begun["one"])[:, 0]) > 0.1  # carts are all along the rail


def test_a_reaching_policy_ignores_the_depth():
    policy = OnnxPolicy("reach")
    policy.target_depth_m = 0.3
    policy.step(np.zeros(8, np.float32), np.array((-0.2, 0.6), np.float32))
    assert policy._input.shape == (1, 10)
