"""A sweep: from a file to a table, restartable; and what a recipe may say."""

import json
from pathlib import Path

import pytest

from softarm.common.batch import Batch, JobsFailed, Workers
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
    runs = sweep.plan(wanted, out)
    assert list(runs) == ["full, seed 1", "mlp, seed 1", "full, seed 2", "mlp, seed 2"]

    killed = runs["mlp, seed 1"]  # after its first checkpoint
    session = begin(killed.recipe, killed.seed, killed.folder, pool, resume=False)
    session.advance()
    session.advance()
    new = []
    first = sweep.run_all(dict(list(runs.items())[:2]), Workers(1), new.append)
    assert [result.name for result in new] == ["full", "mlp"]
    rows = (killed.folder / "learning_curve.csv").read_text().splitlines()
    assert [row.split(",")[1] for row in rows[1:]] == ["256", "512"]  # gone on, not begun again

    results = sweep.run_all(runs, Workers(1), new.append)
    assert [(result.name, result.seed) for result in new[2:]] == [("full", 2), ("mlp", 2)]
    assert results == [*first, *new[2:]]
    assert (out / "mlp" / "seed-1" / first[1].policy).is_file()
    assert (out / "mlp" / "seed-1" / "report.html").is_file()


def test_options_of_a_single_run_are_refused_for_a_sweep(file, tmp_path):
    out = ["--out", str(tmp_path / "out")]
    beside = ["reach", "--seed", "1", "--robots", "16", "--device", "cpu", "--resume", "--from", "dataset"]
    result = invoke("train", "--sweep", file, *out, *beside)
    assert result.exit_code == 1
    for part in ("TASK", "--seed", "--robots", "--device", "--resume", "--from", "seeds: [1]", "run.robots"):
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
        sweep.run_all(sweep.plan(wanted, tmp_path / "runs"), Workers(1))


def test_a_failed_run_is_named(file, tmp_path):
    name, run = next(iter(sweep.plan(sweep.load(file), tmp_path).items()))
    broken = run._replace(recipe=run.recipe.model_copy(update={"model": str(tmp_path / "gone.yaml")}))
    with pytest.raises(JobsFailed, match=r"full, seed 1: ModelFileError: .*\nrepair them and start the sweep again"):
        sweep.run_all({name: broken}, Workers(1))


def test_the_table_has_mean_and_spread_over_seeds():
    def result(name, seed, share):
        return Result(name, seed, {}, 10, 2.0 * seed, share, {"all": share / 2}, "x.onnx")

    rows = sweep.markdown([result("a", 1, 0.8), result("b", 1, 0.5), result("a", 2, 0.6)]).splitlines()
    assert rows[0] == "| configuration | seeds | seconds | validation | all |"
    assert rows[2:] == [
        "| a | 2 | 3 | 70.0 +- 14.1 % | 35.0 +- 7.1 % |",
        "| b | 1 | 2 | 50.0 +- 0.0 % | 25.0 +- 0.0 % |",
    ]


SETTINGS = {
    "run.robots: many": "run.robots is 'many'; allowed: a valid integer; give a value like 2048",
    "run.robots: true": "run.robots is True; allowed: a valid integer; give",
    "run.robots: 10": "run.robots is 10; allowed are multiples of ppo.minibatches, 4; give 12",
    "run.validate_every: 0": "is 0; allowed: greater than or equal to 1; give a value like 20",
    "run.matrix_products: fp16": "is 'fp16'; allowed: 'auto', 'float32' or 'bfloat16'; give",
    "run.device: tpu": "run.device is 'tpu'; allowed: 'cpu' or 'cuda'; give a value like 'cpu'",
    "run.physics_rate_hz: 50": "is 50; allowed: greater than or equal to 120; give",
    "run.patience: -1": "is -1; allowed: greater than or equal to 0; give",
    "run.averaging: 2": "is 2; allowed: less than or equal to 1; give",
    "run.seed: 7": "run.seed is 7; a recipe has no such setting: give --seed",
    "task.name: ../x": "task.name is '../x'; a recipe has no such setting: give another TASK",
    "task.target_y_m: [0, 0, 0]": "give a value like (-0.4, 0.0)",
    "task.target_y_m: [0, -0.4]": "is [0, -0.4]; allowed: a lower number and then a higher one; give",
    "task.rate_hz: 50": "task.rate_hz is 50; allowed: less than or equal to 30; give a value like 30.0",
    "task.success_radius_m: -1": "is -1; allowed: greater than 0; give a value like 0.04",
    "task.rail_braking_m_s2: -1": "task.rail_braking_m_s2 is -1.0; allowed: greater than 0; give a value like 1.7",
    "network.ordr: mlp": "network.ordr: no such setting; network has",
    "network.actions: 5": "network.actions is 5; a recipe has no such setting: remove it",
    "network.mlp: [64.5]": "network.mlp.0 is 64.5; allowed: a valid integer; give a value like (256, 128, 64)",
    "network.mlp: [-1]": "network sizes are '10, 2, -1, 256'; allowed are 1 to 4096 each",
    "ppo.learning_rate: 1e30": "is 1e+30; allowed: less than or equal to 1; give a value like 0.0003",
    "ppo.clip: text": "ppo.clip is 'text'; allowed: a valid number; give a value like 0.2",
}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        *((f"{{seeds: [1], runs: {{a: {{settings: {{{setting}}}}}}}}}", words) for setting, words in SETTINGS.items()),
        ("seeds: [1]", "runs"),
        ("{seeds: [1], runs: {a: {task: fly}}}", "no task 'fly'"),
        ("{seeds: [-1], runs: {a: {}}}", "seeds"),
        (f"{{seeds: [{2**32}], runs: {{a: {{}}}}}}", "seeds.0: is 4294967296; allowed 0 to"),
        ("{seeds: [1], runs: {../a: {}}}", "the name is '../a'; allowed are letters"),
        ("{seeds: [1], runs: {a/b: {}}}", "the name is 'a/b'; allowed are letters"),
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


def test_every_problem_of_a_sweep_is_stated_once(tmp_path):
    path = tmp_path / "bad.yaml"
    path.write_text("{seeds: [1], base: {settings: {ppo.horizon: 0, run.x: 1}}, runs: {a: {}, b: {}, c: {like: x}}}")
    with pytest.raises(SweepError) as caught:
        sweep.load(path)
    both, like, _ = str(caught.value).splitlines()
    assert "runs.a, b: run.x: no such setting" in both
    assert "; ppo.horizon is 0; allowed: greater than or equal to 1; give" in both
    assert like.startswith("runs.c: like is 'x'")


def test_like_starts_from_the_recipe_of_a_shipped_policy():
    wanted = sweep.Sweep.model_validate(
        {"seeds": [1], "base": {"like": "shelf", "frames": 7}, "runs": {"a": {"settings": {"task.muscle": False}}}}
    )
    recipe = wanted.recipe("a")
    assert (recipe.task, recipe.frames) == ("shelf", 7)
    assert prepare(recipe, 1).task.muscle is False
    assert prepare(RECIPES["shelf"], 1).task.muscle is True


@pytest.mark.parametrize("name", ["compare", "ablation"])
def test_the_shipped_sweeps_can_be_run(name):
    assert sweep.load(BENCHMARKS / f"{name}.yaml").runs


def test_settings_have_the_names_of_the_policys_file(tmp_path, pool):
    recipe = Recipe(settings={**TINY, "task.target_z_m": (0.6, 0.65)}, randomise={"arm.payload.mass": (0.0, 0.02)})
    session = begin(recipe, 4, tmp_path, pool, resume=False)
    for name, value in recipe.settings.items():
        assert session.settings[name] == (list(value) if isinstance(value, tuple) else value)
    assert session.settings["randomise.ranges.arm.payload.mass"] == [0.0, 0.02]


@pytest.mark.parametrize(
    ("model", "name"),
    [("seed", "seed"), ("no-delay", "no-delay"), ("mine/seed.yaml", "mine/seed.yaml"), ("m.yaml", "m")],
)
def test_a_model_file_is_not_reported_as_a_shipped_model(model, name):
    assert Recipe(model=model).model_name == name


def test_a_run_on_a_cluster_takes_its_files_and_a_graphics_card_along(file, monkeypatch):
    asked = []
    monkeypatch.setattr(sweep.batch, "run", lambda text, work, *_, **__: asked.append(work) or Batch({}, {}))
    runs = sweep.plan(sweep.load(file), Path("out"))
    sweep.run_all(runs, Workers(1, "local"))
    (work,), run = asked, runs["mlp, seed 2"]
    assert work.writes(run) == [Path("out/mlp/seed-2")]
    assert work.reads(run) == [Path("seed"), Path("out/mlp/seed-2")]
    assert work.cards(run) == 0
    assert work.cards(run._replace(recipe=run.recipe.changed(None, {"run.device": "cuda"}))) == 1


def test_a_recipe_may_set_the_sizes_of_the_network():
    settings = {"network.mlp": [64, 32], "network.state": 48, "task.target_y_m": [-0.3, 0]}
    made = prepare(Recipe.model_validate({"settings": settings}), 1)
    assert (made.network.mlp, made.network.state) == ((64, 32), 48)
    assert made.task.target_y_m == (-0.3, 0.0)
