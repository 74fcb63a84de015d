"""A run end to end: it learns, it is killed, it goes on as if nothing had happened, it leaves a policy."""

import csv
import json
import shlex
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
import yaml
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from softarm.policies.onnx_policy import OnnxPolicy
from softarm.schemas.policy import METADATA_KEY
from softarm.training.learn import validation
from softarm.training.learn.inference import infer, workers
from softarm.training.learn.network import NetworkShape, PolicyNetwork
from softarm.training.learn.ppo import PpoConfig
from softarm.training.record import checkpoint, curve
from softarm.training.record.checkpoint import CheckpointError, TrainingConfig
from softarm.training.record.export import export_checkpoint, onnx_model
from softarm.training.run import recipe
from softarm.training.run.session import Session, averaged_share
from softarm.training.task.environment import ACTIONS, INPUTS, Environment
from softarm.training.task.reach import TASKS
from tests.cli.invoke import invoke

TASK = replace(TASKS["reach"], episode_steps=20)
SMALL = TrainingConfig(seed=3, robots=16, validate_every=2, validation_trials=6)
FRAMES = 16 * 16


def session(out: Path, pool, resume: bool = False, config: TrainingConfig = SMALL) -> Session:
    return Session(TASK, config, PpoConfig(), out, pool, resume)


def lively_network(order: str = "mlp-lstm") -> PolicyNetwork:
    """Random weights whose actions use the whole range, and a normaliser that has seen something."""
    torch.manual_seed(0)
    network = PolicyNetwork(NetworkShape(INPUTS, ACTIONS, order=order))
    environment = Environment(TASK, 64, 0)
    network.observation_normaliser.update(torch.from_numpy(environment.reset()))
    rng = np.random.default_rng(0)
    for _ in range(10):
        step = environment.step(rng.uniform(-1, 1, (64, 2)).astype(np.float32))
        network.observation_normaliser.update(torch.from_numpy(step.observation))
    with torch.no_grad():
        network.mean_head.weight.mul_(3.0)
    return network


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Session:
    """Four iterations without a break."""
    with workers(2) as pool:
        run = session(tmp_path_factory.mktemp("whole"), pool)
        run.run(frames=4 * FRAMES, minutes=None)
    return run


def points(folder):
    """Return (frames, value) of each point that TensorBoard shows, by tag."""
    events = EventAccumulator(str(folder)).Reload()
    return {tag: [(each.step, each.value) for each in events.Scalars(tag)] for tag in events.Tags()["scalars"]}


def stored(rows):
    """Return the learning curve as TensorBoard stores it, in float32."""
    by_tag = {}
    for tag, column in curve.SCALARS.items():
        values = [(row.frames, getattr(row, column)) for row in rows]
        by_tag[tag] = [(frames, pytest.approx(value, rel=1e-6)) for frames, value in values if value is not None]
    return {tag: values for tag, values in by_tag.items() if values}


@pytest.mark.slow
@pytest.mark.usefixtures("plain_pictures")
def test_a_killed_run_is_resumed_bit_for_bit_and_each_point_is_shown_once(finished, tmp_path, pool):
    killed = session(tmp_path, pool)
    for _ in range(3):  # one beyond its last checkpoint
        killed.advance()
    killed.events.close()
    assert len(points(tmp_path / "tensorboard")["learner/kl"]) == 3
    resumed = session(tmp_path, pool, resume=True)
    assert len(resumed.curve) == 2
    resumed.run(frames=4 * FRAMES, minutes=None)
    for mine, theirs in (
        (resumed.network.state_dict(), finished.network.state_dict()),
        (resumed.average.state_dict(), finished.average.state_dict()),
    ):
        assert all(torch.equal(mine[key], theirs[key]) for key in theirs)

    def without_time(rows):
        return [row._replace(seconds=0.0, frames_per_s=0.0) for row in rows]

    assert without_time(resumed.curve) == without_time(finished.curve)
    assert points(tmp_path / "tensorboard") == stored(resumed.curve)
    assert resumed.events.fault is None


@pytest.mark.usefixtures("plain_pictures")
def test_validation_uses_a_moving_average_of_the_weights(tmp_path, pool):
    run = session(tmp_path, pool)
    expected = torch.zeros_like(run.network.value_head.weight)
    seen = []
    for k in range(3):
        run.advance()
        seen.append(run.network.value_head.weight.detach().clone())
        expected = expected.lerp(seen[-1], averaged_share(k, run.config.averaging))
    torch.testing.assert_close(run.average.value_head.weight.detach(), expected, atol=1e-7, rtol=1e-4)
    assert (seen[1] - seen[0]).abs().max() > 1e-5
    assert torch.equal(run.average.observation_normaliser.mean, run.network.observation_normaliser.mean)
    # Untrained weights are soon forgotten, and then the average moves slowly.
    assert [averaged_share(k, 0.975) for k in (0, 100, 2000)] == pytest.approx([1.0, 10 / 110, 0.025])


def test_a_run_writes_its_learning_curve_as_table_and_picture(finished):
    with (finished.out / "learning_curve.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["frames"]) for row in rows] == [FRAMES * k for k in (1, 2, 3, 4)]
    assert [bool(row["validation"]) for row in rows] == [False, True, False, True]
    shares = [finished.finished(*ends) for ends in ((8 * FRAMES, None), (8 * FRAMES, 1e-9), (None, 1e9))]
    assert shares == [0.5, 1.0, pytest.approx(0.0, abs=1e-6)]
    assert (finished.out / "learning_curve.png").read_bytes().startswith(b"\x89PNG")


def test_the_policy_file_describes_itself_and_reproduces_its_golden_run(finished):
    described = OnnxPolicy(str(finished.out / "reach.onnx")).metadata  # loading replays the golden run
    assert described.trained.target_z_m == TASK.target_z_m
    assert (described.seed, described.training["run.robots"]) == (3, 16)
    assert described.validation_success == finished.best
    assert len(described.golden.inputs) == 100


@pytest.mark.parametrize("order", ["mlp-lstm", "lstm-mlp", "mlp"])
def test_onnx_equals_torch_over_full_episodes_with_resets(order, pool):
    network, robots = lively_network(order), 16
    policy = onnxruntime.InferenceSession(onnx_model(network).SerializeToString())
    environment = Environment(TASK, robots, 1)
    observation = environment.reset()
    environment.stagger()
    state, keep = network.initial_state(robots), torch.ones(robots)
    h, c = (part.numpy()[None] for part in state)
    resets, spread = 0, []
    for _ in range(40):
        mean, _, state = infer(network, torch.from_numpy(observation), keep, state, pool)
        kept = keep.numpy()[None, :, None]
        feed = {"observation": observation, "h_in": h * kept, "c_in": c * kept}
        action, h, c = policy.run(None, feed)
        np.testing.assert_allclose(action, mean.clamp(-1, 1).numpy(), atol=1e-5, rtol=0)
        spread.append(action.std())
        step = environment.step(action)
        over = step.terminated | step.truncated
        resets += int(over.sum())
        keep, observation = torch.from_numpy(1.0 - over.astype(np.float32)), step.observation
    assert resets >= robots
    assert np.mean(spread) > 0.05  # actions that all look alike would prove nothing


def test_the_graph_needs_no_operator_set_above_17():
    model = onnx_model(lively_network())
    assert [(entry.domain, entry.version) for entry in model.opset_import] == [("", 17)]
    onnx.checker.check_model(model, full_check=True)
    names = [[value.name for value in values] for values in (model.graph.input, model.graph.output)]
    assert names == [["observation", "h_in", "c_in"], ["action", "h_out", "c_out"]]


def test_other_settings_cannot_resume_a_run(finished, tmp_path, pool):
    with pytest.raises(CheckpointError, match=r"run\.seed = 3, not 4"):
        session(finished.out, pool, resume=True, config=replace(SMALL, seed=4))
    saved = checkpoint.load(finished.out / "latest.pt")
    drawn = {"randomise.ranges.arm.payload.mass": [0.0, 0.1]}
    checkpoint.save(tmp_path / "latest.pt", saved | {"settings": saved["settings"] | drawn})
    with pytest.raises(CheckpointError, match=r"arm\.payload\.mass = \[0\.0, 0\.1\], not None"):
        session(tmp_path, pool, resume=True)


def test_a_run_is_resumed_with_its_matrix_products_on_another_processor(finished, tmp_path, pool):
    """`auto` selects by the processor, but a run keeps its first choice."""
    saved = checkpoint.load(finished.out / "latest.pt")
    other = {"float32": "bfloat16", "bfloat16": "float32"}[finished.settings["run.matrix_products"]]
    checkpoint.save(tmp_path / "latest.pt", saved | {"settings": saved["settings"] | {"run.matrix_products": other}})
    assert session(tmp_path, pool, resume=True).settings["run.matrix_products"] == other


def test_a_checkpoint_without_a_learner_cannot_resume_a_run(finished, tmp_path, pool):
    (tmp_path / "latest.pt").write_bytes((finished.out / "best.pt").read_bytes())
    with pytest.raises(CheckpointError, match=r"latest\.pt: learner missing; .* best\.pt for `softarm dev export`"):
        session(tmp_path, pool, resume=True)


@pytest.mark.prove
@pytest.mark.usefixtures("plain_pictures")
def test_a_run_ends_after_validations_without_improvement(tmp_path, pool):
    config = replace(SMALL, validate_every=1, patience=2)
    run = session(tmp_path, pool, config=config)
    run.run(frames=100 * 256, minutes=None)
    validated = [row.validation for row in run.curve]
    assert len(validated) < 100
    assert max(validated[-2:]) <= max(validated[:-2])


def test_a_diverged_network_is_not_exported(finished, tmp_path):
    saved = checkpoint.load(finished.out / "best.pt")
    saved["average"]["mean_head.bias"].fill_(torch.nan)
    checkpoint.save(tmp_path / "best.pt", saved)
    with pytest.raises(CheckpointError, match=r"the network's action is \[nan, nan\] in the golden run; allowed"):
        export_checkpoint(tmp_path / "best.pt", tmp_path / "out.onnx")


def test_a_damaged_checkpoint_is_refused(tmp_path):
    path = tmp_path / "broken.pt"
    path.write_bytes(b"not a checkpoint")
    with pytest.raises(CheckpointError, match=r"broken\.pt: not a checkpoint"):
        export_checkpoint(path, tmp_path / "out.onnx")
    assert not (tmp_path / "out.onnx").exists()


@pytest.mark.parametrize(
    "changed",
    [
        {"network": ["mlp"]},
        {"network": {"state": 7}},
        {"average": {}},
    ],
)
def test_a_checkpoint_without_a_valid_network_is_refused(tmp_path, changed):
    whole = {"settings": {}, "task": {}, "seed": 1, "curve": [], "average": PolicyNetwork(NetworkShape()).state_dict()}
    checkpoint.save(tmp_path / "odd.pt", whole | changed)
    with pytest.raises(CheckpointError, match=r"odd\.pt: holds no network"):
        checkpoint.load_policy(tmp_path / "odd.pt")


def test_the_validation_set_contains_no_test_target():
    trials, grid = validation.validation_scenarios(TASK, 5), validation.grid_scenarios(5)
    assert len(np.unique(grid.target_m, axis=0)) == 54
    assert sorted(np.unique(grid.starts.cart_position_m)) == pytest.approx([0.0, 0.1, 0.2])
    apart = np.linalg.norm(trials.target_m[:, None] - grid.target_m[None], axis=2)
    assert apart.min() > 0.0
    assert np.mean(trials.target_m[:, 1] <= 0.70) == pytest.approx(2 / 3, abs=0.01)


@pytest.mark.slow
@pytest.mark.usefixtures("plain_pictures", "short_validation")
def test_the_commands_train_and_export(tmp_path, monkeypatch):
    monkeypatch.setitem(recipe.RECIPES, "reach", recipe.RECIPES["reach"].model_copy(update={"frames": 256}))
    out = tmp_path / "it's a run"
    arguments = ["train", "reach", "--robots", "16", "--frames", "256", "--seed", "5", "--out", str(out)]
    result = invoke(*arguments)
    assert result.exit_code == 0, result.output
    assert f"softarm evaluate {shlex.quote(str(out))} reach" in result.output
    written = subprocess.run(result.output.splitlines()[-1].partition(" > ")[0], shell=True, capture_output=True)
    options = yaml.safe_load(written.stdout)["policies"]["my-reach"]["options"]
    assert options == {"model": str(out / "reach.onnx")}
    assert "report.html" in result.output
    for name in ("reach.onnx", "report.html", "tip_paths.png", "tensorboard"):
        assert (out / name).exists()

    again = invoke(*arguments)
    assert again.exit_code == 1
    assert "--resume" in again.output

    exported = tmp_path / "copy.onnx"
    result = invoke("dev", "export", out / "best.pt", "--out", exported)
    assert result.exit_code == 0, result.output
    metadata = {p.key: p.value for p in onnx.load(exported).metadata_props}
    assert json.loads(metadata[METADATA_KEY])["seed"] == 5

    result = invoke("dev", "export", tmp_path / "missing.pt", "--out", exported)
    assert result.exit_code == 1
    assert "no such checkpoint" in result.output
