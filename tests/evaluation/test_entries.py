"""Rows of a comparison: names, ONNX files, folders of runs and of sweeps."""

import pytest

from softarm.evaluation import entries
from softarm.policies.base import MODELS, PolicyError
from softarm.schemas.config import Config

FAILING = """
from softarm.policies.base import PolicySpec

class Failing:
    spec = PolicySpec("failing", "raises at its first step")

    def reset(self):
        pass

    def step(self, observation, goal):
        raise ValueError("boom")
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Change to a folder with a run, a sweep of two names and two seeds, and an unfinished run."""
    monkeypatch.chdir(tmp_path)
    for place, model in (
        ("runs/mine/reach", "reach-wide"),
        ("runs/sweep/full/seed-1/reach", "reach"),
        ("runs/sweep/full/seed-2/reach", "reach-wide"),
        ("runs/sweep/less/seed-1/reach", "reach"),
    ):
        file = tmp_path / f"{place}.onnx"
        file.parent.mkdir(parents=True)
        file.symlink_to(MODELS / f"{model}.onnx")
    (tmp_path / "runs" / "begun").mkdir()
    (tmp_path / "runs" / "begun" / "latest.pt").touch()
    return tmp_path


def rows(*policies, config=None):
    return [(entry.name, entry.seed, str(entry.file or "")) for entry in entries.given(policies, config)]


def test_any_mixture_of_policies_keeps_its_order(folder):
    found = rows("pid", "runs/mine", "runs/mine/reach.onnx", "ceiling", "reach", "pid")
    assert [name for name, _, _ in found] == ["pid", "runs/mine", "runs/mine/reach.onnx", "ceiling", "reach"]
    assert [file for _, _, file in found] == ["", "runs/mine/reach.onnx", "runs/mine/reach.onnx", "", ""]


def test_the_folder_of_a_sweep_gives_all_its_policies_with_their_seeds(folder):
    assert [(name, seed) for name, seed, _ in rows("runs/sweep")] == [
        ("runs/sweep/full", 1),
        ("runs/sweep/full", 2),
        ("runs/sweep/less", 1),
    ]
    assert [(name, seed) for name, seed, _ in rows("runs/sweep/full/")] == [
        ("runs/sweep/full/", 1),
        ("runs/sweep/full/", 2),
    ]


def test_a_name_precedes_a_folder_of_that_name(folder):
    (folder / "reach").symlink_to(folder / "runs" / "mine")
    assert [file for _, _, file in rows("reach", "./reach")] == ["", "reach/reach.onnx"]


def test_a_policy_that_fails_at_its_first_step_is_refused(install):
    """The daemon refuses it too; its flights would count as missed."""
    install("other_arm", FAILING, failing="Failing")
    with pytest.raises(PolicyError, match="policy 'failing': step raised ValueError: boom; repair it"):
        rows("failing")


def test_a_policy_of_the_configuration_is_known(folder):
    config = Config.model_validate(
        {"policies": {"mine": {"plugin": "onnx", "options": {"model": "runs/mine/reach.onnx"}}}}
    )
    assert [name for name, _, _ in rows("mine", config=config)] == ["mine"]


def test_a_file_in_a_folder_of_several_has_its_path_as_the_name(folder):
    (folder / "runs" / "mine" / "copy.onnx").symlink_to(MODELS / "reach.onnx")
    assert [name for name, _, _ in rows("runs/mine")] == ["runs/mine/copy.onnx", "runs/mine/reach.onnx"]


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        ("runs/mnie", "runs/mnie: does not exist; name an ONNX file, or the folder"),
        ("runs/begun", "runs/begun: the run has not written its policy yet"),
        ("runs", r"runs: no policy .* in this folder; name one of runs/mine"),
        ("damaged", "no policy damaged; "),
        ("broken", "policy broken: option model"),
    ],
)
def test_a_policy_that_cannot_be_used_is_named(folder, policy, message):
    config = Config.model_validate({"policies": {"broken": {"plugin": "onnx", "options": {"model": "no.onnx"}}}})
    with pytest.raises(PolicyError, match=message):
        entries.given(["pid", policy], config)


def test_the_policies_of_a_sweep_replace_shipped_ones_of_the_same_name(folder):
    (folder / "runs" / "sweep" / "pid").symlink_to(folder / "runs" / "sweep" / "full")
    found = entries.every(folder / "runs" / "sweep", ("pid", "reach"))
    assert [(entry.name, entry.seed, entry.file is None) for entry in found if entry.name == "pid"] == [
        ("pid", 1, False),
        ("pid", 2, False),
    ]
    assert {entry.name for entry in entries.every(folder / "runs" / "sweep", only_runs=True)} == {"full", "less", "pid"}
    with pytest.raises(PolicyError, match="no NAME/seed-K"):
        entries.every(folder / "runs" / "mine")
    with pytest.raises(PolicyError, match="policy hold: it takes no targets"):
        entries.every(None, ("hold",))
