"""Tasks of other packages: found by name, trained, recorded, and refused with a reason."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softarm.common.plugins import PluginError
from softarm.policies.onnx_policy import OnnxPolicy
from softarm.training.record.checkpoint import CheckpointError, load, task_of, usual
from softarm.training.run import recipe, retrain
from softarm.training.task import registry
from softarm.training.task.environment import Environment
from softarm.training.task.reach import ReachTask, Starts
from tests.cli.invoke import invoke

NEAR = """
    from dataclasses import dataclass, field
    import numpy as np
    from softarm.training.task.reach import ReachTask

    @dataclass(frozen=True)
    class Near(ReachTask):
        name: str = "whatever"
        target_z_m: tuple[float, float] = (0.60, 0.62)
        weight: float = 2.0

        def reward(self, now):
            apart = np.linalg.norm(now.tip_m - now.target_m, axis=1)
            return (-self.weight * apart).astype(np.float32)

    high = ReachTask(name="whatever", target_z_m=(0.7, 0.75))

    @dataclass(frozen=True)
    class Sloped(ReachTask):
        slope: float = field(kw_only=True)

    sloped = Sloped(slope=0.1)

    class Newer(Near):
        interface = 2

    @dataclass(frozen=True)
    class Unrecordable(ReachTask):
        extra: dict = field(default_factory=dict)

    @dataclass(frozen=True)
    class Untyped(ReachTask):
        extra: "Missing" = 1.0

    @dataclass(frozen=True)
    class Wrong(ReachTask):
        def sample_targets(self, rng, count):
            return rng.random((2, count))

    class Stranger:
        pass
"""


@pytest.fixture
def near(install):
    names = {name.lower(): name for name in ("Near", "Newer", "Unrecordable", "Untyped", "Wrong", "Stranger")}
    install("tasks_of_theirs", NEAR, "softarm.tasks", high="high", sloped="sloped", **names)


def test_a_task_has_the_name_of_its_entry_point(near):
    task = registry.load("near")
    assert (task.name, task.weight, registry.plugin_of(task)) == ("near", 2.0, "near")
    assert recipe.preset("near") == task
    plain = registry.load("high")
    assert (plain.name, plain.target_z_m, registry.plugin_of(plain)) == ("high", (0.7, 0.75), None)
    assert recipe.named("near").task == "near"
    assert recipe.prepare(recipe.named("near"), 1).task == task
    assert recipe.preset("reach") == ReachTask()  # the house's own come first


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("nere", r"no task 'nere'; did you mean 'near'\?"),
        ("newer", "written for interface 2, this software speaks 1"),
        ("unrecordable", r"its field extra is \{\}; allowed are numbers, texts"),
        ("untyped", "name 'Missing' is not defined"),
        ("stranger", "it is a Stranger, not derived from ReachTask"),
    ],
)
def test_an_unusable_task_is_refused_with_the_reason(name, text, near):
    with pytest.raises(PluginError, match=f"task '{name}': .*{text}"):
        registry.load(name)


def test_a_published_task_is_its_own_default(near):
    task = registry.load("sloped")
    settings = usual(replace(task, slope=0.2), 10)
    assert (settings["task.slope"], settings["task.plugin"]) == (0.1, "sloped")


def test_a_field_that_the_task_no_longer_has_is_stated(near):
    for fields in ({"plugin": "near", "gone": 1.0}, {"plugin": "gone"}):
        with pytest.raises(CheckpointError, match=r"best\.pt: its task .*gone.*; install the package and version"):
            task_of(Path("best.pt"), {"task": fields})


def test_the_environment_uses_the_tasks_reward(near):
    task = replace(registry.load("near"), action_noise=0.0)
    environment = Environment(task, 8, 0)
    environment.reset()
    step = environment.step(np.zeros((8, 2), np.float32))
    apart = np.linalg.norm(step.final_tip_m - step.final_observation[:, 8:10], axis=1)
    np.testing.assert_allclose(step.reward, -2.0 * apart, rtol=1e-6)


@pytest.mark.parametrize(
    ("method", "body", "text"),
    [
        ("reward", lambda self, now: 1.0, r"reward gave float; allowed is float32 \(4,\)"),
        ("reward", lambda self, now: now.success, r"reward gave bool \(4,\); allowed is float32 \(4,\)"),
        ("reward", lambda self, now: now.tip_m, r"reward gave float32 \(4, 2\); allowed"),
        ("reward", lambda self, now: now.tip_speed_m_s * np.nan, "reward gave nan for robot 0"),
        ("reward", lambda self, now: now.speed, "reward raised AttributeError: .*no attribute 'speed'"),
        ("succeeded", lambda self, tip, target: tip[:, 0], r"succeeded gave float32 \(4,\); allowed is bool \(4,\)"),
        ("succeeded", lambda self, tip, target: (tip < target).any(), r"succeeded gave bool.*; allowed is bool \(4,\)"),
        ("sample_targets", lambda self, rng, count: rng.random((2, count)), r"gave float64 \(2, 4\); allowed"),
        ("sample_targets", lambda self, rng, count: rng.random((count, 2)) * np.nan, r"gave \[nan nan\] for robot 0"),
        ("sample_targets", lambda self, rng, count: rng.uniform(0, -1, (count, 2)), "raised (Value|Overflow)Error"),
        ("sample_starts", lambda self, rng, count, links: rng.random(count), r"gave float64 \(4,\); allowed is Starts"),
        (
            "sample_starts",
            lambda self, rng, count, links: Starts(*(rng.random(count) for _ in range(3))),
            r"joint_angles_rad of sample_starts gave float64 \(4,\); allowed is float32 \(4, 5\)",
        ),
    ],
)
def test_an_invalid_result_of_a_method_is_refused(method, body, text):
    environment = Environment(type("Odd", (ReachTask,), {method: body})(name="odd"), 4, 0)
    with pytest.raises(PluginError, match=f"task 'odd': .*{text}"):
        environment.reset(), environment.step(np.zeros((4, 2), np.float32))


def test_an_error_of_a_task_ends_the_training_with_its_text(near, tmp_path):
    result = invoke("train", "wrong", "--robots", 8, "--out", tmp_path / "run")
    assert result.exit_code == 1
    assert "task 'wrong': sample_targets gave float64 (2, 1536); allowed is float32 (1536, 2)" in result.output


@pytest.mark.slow
@pytest.mark.usefixtures("plain_pictures")
def test_a_plugin_task_is_trained_and_recorded_in_its_files(near, tmp_path, pool):
    out, settings = tmp_path / "run", {"run.robots": 8, "run.validation_trials": 12}
    recipe.begin(recipe.named("near").changed(None, settings), 1, out, pool, resume=False).run(128, None)
    saved = load(out / "best.pt")
    assert saved["settings"]["task.plugin"] == "near"
    assert task_of(out / "best.pt", saved) == registry.load("near")
    policy = OnnxPolicy(str(out / "near.onnx"))
    assert policy.metadata.name == "near"
    assert policy.metadata.training["task.weight"] == 2.0
    assert "task's own ranges" in policy.metadata.training["run.validation_set"]
    assert retrain.load_weights(out / "near.onnx").task == registry.load("near")
