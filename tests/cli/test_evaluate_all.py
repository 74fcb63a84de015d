"""`softarm evaluate --all`: one table, as JSON, Markdown and a page that needs nothing else."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks import comparison, comparison_page, trials
from cli.main import main
from daemon.offline import Lockstep
from policies import registry
from policies.onnx_policy import OnnxPolicy
from policies.pid import Pid
from schemas.config import Config
from schemas.goals import TEST_TARGETS, Goal

MODELS = Path(comparison.__file__).parents[1] / "policies" / "models"


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
    assert "http" not in text  # nothing is fetched
    for words in ("mine", "pid", "the paper&#x27;s PID"):
        assert words in text
        assert words.replace("&#x27;", "'") in result.output


def test_a_test_on_another_model_gets_a_column_of_its_own():
    found = comparison.entries(None, ("pid",))
    result = comparison.compare(found, 1, ("shelf@no-delay",))
    assert list(result["policies"]["pid"]) == ["shelf@no-delay"]
    assert "on no-delay" in comparison_page.markdown(result)


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
    assert {(goal.y_m, goal.z_m) for goal, _, _ in twelve} == {
        (-0.48, 0.6),
        (-0.48, 0.63),
        (-0.48, 0.66),
        (-0.53, 0.63),
    }
    assert trials.random_shelf_trials() == trials.random_shelf_trials()
    for goal, depth, start in trials.random_shelf_trials():
        assert -0.48 <= goal.y_m <= -0.40
        assert 0.58 <= goal.z_m <= 0.67
        assert -0.05 <= depth <= 0.20
        assert -0.025 <= start <= 0.24


def test_a_policy_that_asks_for_the_depth_is_told_and_the_shelf_is_in_the_way():
    told = []

    class Deep(Pid):
        target_depth_m = 0.0

        def step(self, observation, goal):
            told.append(self.target_depth_m)
            return super().step(observation, goal)

    reached = trials.fly_shelf(Deep(), None, [(Goal("reach", -0.45, 0.6), 0.07, 0.1)])
    assert reached == [False]
    assert set(told) == {0.07}


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
        for number in range(4):
            swung = trials.Swung(Sees(name), number)
            daemon = Lockstep(Config(), swung)
            daemon.arm()
            daemon.place(swung.cart_start_m)
            daemon.tick(daemon.request("goal", Goal("reach", 0.0, 0.9)))
            for _ in range(swung.ticks):
                daemon.tick()
            daemon.tick(daemon.request("goal", TEST_TARGETS[0]))
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
