"""A sweep: from a file to a table, restartable; and what a recipe may say."""

import json
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from softarm.training.run import sweep
from softarm.training.run.recipe import RECIPES, Recipe, begin, prepare
from softarm.training.run.sweep import Result, SweepError
from tests.cli.invoke import invoke

BENCHMARKS = Path(__file__).parents[3] / "benchmarks"
TINY = {"run.robots": 16, "run.validate_every": 2, "run.validation_trials": 12}
FILE = """
seeds: [1, 2]
base: {task: reach, frames: 512, settings: {run.robots: 16, run.validate_every: 2, run.validation_trials: 12}}
runs:
  full: {}
  mlp: {settings: {network.order: mlp}}
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "sweep.yaml"
    path.write_text(FILE)
    return path


@pytest.mark.prove
@pytest.mark.usefixtures("plain_pictures")
def test_a_restarted_sweep_skips_finished_runs(file, tmp_path, pool):
    out, wanted = tmp_path / "runs", sweep.load(file)
    todo, finished = sweep.plan(wanted, out, threads=1)
    assert [(work.name, work.seed) for work in todo] == [("full", 1), ("mlp", 1), ("full", 2), ("mlp", 2)]
    assert finished == []

    killed = todo[1]  # after its first checkpoint
    session = begin(Recipe.model_validate(killed.recipe), killed.seed, Path(killed.folder), pool, resume=False)
    session.advance()
    session.advance()
    results = list(sweep.locally(todo[:2], 1))
    assert {result.name for result in results} == {"full", "mlp"}
    rows = (Path(killed.folder) / "learning_curve.csv").read_text().splitlines()
    assert [row.split(",")[1] for row in rows[1:]] == ["256", "512"]  # gone on, not begun again

    left, done = sweep.plan(wanted, out, threads=1)
    assert [(work.name, work.seed) for work in left] == [("full", 2), ("mlp", 2)]
    assert done == sorted(results, key=lambda each: each.name)
    assert (out / "mlp" / "seed-1" / done[1].policy).is_file()
    assert (out / "mlp" / "seed-1" / "report.html").is_file()


def test_options_of_a_single_run_are_refused_for_a_sweep(file, tmp_path):
    out = ["--out", str(tmp_path / "out")]
    beside = ["reach", "--seed", "1", "--robots", "16", "--device", "cpu", "--resume"]
    result = invoke("train", "--sweep", file, *out, *beside)
    assert result.exit_code == 1
    for part in ("TASK", "--seed", "--robots", "--device", "--resume", "seeds: [1]", "run.robots"):
        assert part in result.output
    assert "--frames" not in result.output  # was not given
    assert "--out" not in result.output
    assert not (tmp_path / "out").exists()


def test_a_finished_run_of_another_recipe_is_refused(file, tmp_path):
    wanted = sweep.load(file)
    folder = tmp_path / "runs" / "full" / "seed-1"
    folder.mkdir(parents=True)
    other = Result("full", 1, Recipe(task="reach").model_dump(mode="json"), 1, 1.0, 0.5, {}, "reach.onnx")
    (folder / sweep.RESULT).write_text(json.dumps(other._asdict()))
    with pytest.raises(SweepError, match="another recipe"):
        sweep.plan(wanted, tmp_path / "runs", threads=1)


def test_a_failed_run_is_named(file, tmp_path):
    todo, _ = sweep.plan(sweep.load(file), tmp_path, threads=1)
    broken = todo[0]._replace(recipe=todo[0].recipe | {"model": str(tmp_path / "gone.yaml")})
    with pytest.raises(SweepError, match="full, seed 1: ModelFileError"):
        list(sweep.locally([broken], 1))


def test_the_table_has_mean_and_spread_over_seeds():
    def result(name, seed, share):
        return Result(name, seed, {}, 10, 2.0 * seed, share, {"all": share / 2}, "x.onnx")

    rows = sweep.markdown([result("a", 1, 0.8), result("b", 1, 0.5), result("a", 2, 0.6)]).splitlines()
    assert rows[0] == "| configuration | seeds | seconds | validation | all |"
    assert rows[2:] == [
        "| a | 2 | 3 | 70.0 +- 14.1 % | 35.0 +- 7.1 % |",
        "| b | 1 | 2 | 50.0 +- 0.0 % | 25.0 +- 0.0 % |",
    ]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("seeds: [1]", "runs"),
        ("{seeds: [1], runs: {a: {task: fly}}}", "no task 'fly'"),
        ("{seeds: [1], runs: {a: {settings: {network.ordr: mlp}}}}", "network.ordr: no such setting; network has"),
        ("{seeds: [1], runs: {a: {settings: {run.robots: many}}}}", "run.robots is 'many'"),
        ("{seeds: [1], runs: {a: {randomise: {arm.payload.mass: [0, 9]}}}}", "arm.payload"),
        ("{seeds: [1], runs: {a: {model: no-dely}}}", "did you mean no-delay"),
        ("{seeds: [1], runs: {a: {like: fly}}}", "give one of reach"),
        ("{seeds: [1], runs: {a: {like: [reach]}}}", "give one of reach"),
        ("{seeds: [1], runs: {a: {settings: 3}}}", "settings is 3; give a group of keys"),
        ("{seeds: [1], base: {randomise: [1]}, runs: {a: {}}}", "randomise is [1]; give a group of keys"),
        ("[1", "bad.yaml:1: not valid YAML: while parsing a flow sequence"),
    ],
)
def test_an_invalid_sweep_is_refused_before_any_run(tmp_path, text, words):
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(SweepError, match=r"bad\.yaml") as caught:
        sweep.load(path)
    assert words in str(caught.value)
    result = invoke("train", "--sweep", path, "--out", tmp_path / "out")
    assert result.exit_code == 1
    assert words.split("'")[0] in result.output


def test_like_starts_from_the_recipe_of_a_shipped_policy():
    wanted = sweep.Sweep.model_validate(
        {"seeds": [1], "base": {"like": "shelf", "frames": 7}, "runs": {"a": {"settings": {"task.muscle": False}}}}
    )
    recipe = wanted.recipes()["a"]
    assert (recipe.task, recipe.frames) == ("shelf", 7)
    assert prepare(recipe, 1).task.muscle is False
    assert prepare(RECIPES["shelf"], 1).task.muscle is True


@pytest.mark.parametrize("name", ["compare", "ablation"])
def test_the_shipped_sweeps_can_be_run(name):
    assert sweep.load(BENCHMARKS / f"{name}.yaml").recipes()


def test_settings_have_the_names_of_the_policys_file(tmp_path, pool):
    recipe = Recipe(settings={**TINY, "task.target_z_m": (0.6, 0.65)}, randomise={"arm.payload.mass": (0.0, 0.02)})
    session = begin(recipe, 4, tmp_path, pool, resume=False)
    for name, value in recipe.settings.items():
        assert session.settings[name] == (list(value) if isinstance(value, tuple) else value)
    assert session.settings["randomise.ranges.arm.payload.mass"] == [0.0, 0.02]


class FakeRay:
    """Stand-in for the part of Ray that a sweep uses; the last run finishes first."""

    def __init__(self):
        self.asked, self.open = [], False

    def init(self, address, **_options):
        if address != "local":
            raise ConnectionError(f"could not reach {address}\nand much more")
        self.open = True

    def shutdown(self):
        self.open = False

    def remote(self, **options):
        def task(function, asked=options):
            def start(work):
                self.asked.append(asked)
                return lambda: function(work)

            return SimpleNamespace(options=lambda **more: task(function, asked | more), remote=start)

        return task

    def wait(self, waiting, num_returns):
        return waiting[-1:], waiting[:-1]

    def get(self, ready):
        return ready()


@pytest.fixture
def ray(monkeypatch):
    fake = FakeRay()
    monkeypatch.setitem(sys.modules, "ray", fake)
    return fake


def test_a_cluster_yields_results_and_is_detached(file, tmp_path, ray, monkeypatch):
    monkeypatch.setattr(sweep, "train", lambda work: (work.name, work.seed, ray.open))
    todo, _ = sweep.plan(sweep.load(file), tmp_path, threads=3)
    assert list(sweep.on_ray(todo[:2], "local")) == [("mlp", 1, True), ("full", 1, True)]
    assert ray.asked == 2 * [{"max_retries": 0, "num_cpus": 3, "num_gpus": 0}]
    assert not ray.open
    on_card = todo[0]._replace(recipe=todo[0].recipe | {"settings": {"run.device": "cuda"}})
    assert list(sweep.on_ray([on_card], "local"))
    assert ray.asked[-1]["num_gpus"] == 1


def test_a_missing_cluster_and_a_failed_run_on_one_are_reported(file, tmp_path, ray, monkeypatch):
    todo, _ = sweep.plan(sweep.load(file), tmp_path, threads=1)
    with pytest.raises(SweepError, match=r"no Ray cluster at 'far:1': could not reach far:1; give"):
        next(sweep.on_ray(todo, "far:1"))

    def fails(work):
        raise OSError("disk full")

    monkeypatch.setattr(sweep, "train", fails)
    with pytest.raises(SweepError, match="mlp, seed 2: OSError: disk full"):
        list(sweep.on_ray(todo, "local"))
    assert not ray.open


def test_a_cluster_without_ray_is_refused_with_the_install_command(file, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    todo, _ = sweep.plan(sweep.load(file), tmp_path, threads=1)
    with pytest.raises(SweepError, match=r"pip install 'softarm\[ray\]'"):
        next(sweep.on_ray(todo, "local"))
