"""`softarm train --from`: from a recorded log over a LeRobot dataset to a policy that flies."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softarm.daemon.runtime.offline import Lockstep
from softarm.policies.onnx_policy import OnnxPolicy
from softarm.recordings import lerobot
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal
from softarm.training.run import clone
from tests.cli.invoke import invoke

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("plain_pictures", "short_validation")]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory) -> Path:
    """Return a dataset of flights that the example has recorded."""
    folder = tmp_path_factory.mktemp("cloning")
    sys.path.insert(0, str(Path(__file__).parents[3] / "examples" / "cloning"))
    import demonstrations

    sys.path.pop(0)
    reached = demonstrations.record("reach-wide", 12, folder / "log.mcap")
    assert invoke("logs", "export", "--to", "lerobot", "--out", folder / "dataset", folder / "log.mcap").exit_code == 0
    assert sum(episode.reached for episode in lerobot.read(folder / "dataset")) == reached >= 8
    return folder / "dataset"


def test_a_cloned_policy_flies_and_its_file_has_dataset_and_ranges(dataset, tmp_path, monkeypatch):
    monkeypatch.setattr(clone, "FRAMES", 3000)
    monkeypatch.setattr(clone, "VALIDATIONS", 2)
    ran = invoke("train", "--from", dataset, "--out", tmp_path / "run")
    assert ran.exit_code == 0, ran.output
    kept = [episode for episode in lerobot.read(dataset) if episode.reached]
    assert f"{dataset}: {len(kept)} episodes; {12 - len(kept)} that missed their target are left out" in ran.output
    assert "action error on the held-out episodes: " in ran.output
    policy = OnnxPolicy(str(tmp_path / "run" / "reach.onnx"))
    training = policy.metadata.training
    assert (training["clone.dataset"], training["clone.episodes"]) == (str(dataset), len(kept))
    targets = np.array([episode.state[0, 8:] for episode in kept])
    assert policy.metadata.trained.target_z_m == (targets[:, 1].min(), targets[:, 1].max())
    flight = Lockstep(Config(), policy).fly(Goal("reach", -0.2, 0.6), 0.1)
    assert flight.status.closest_m < 0.05  # 0.07 without learning


def test_an_unusable_dataset_is_refused_with_its_reason(dataset, tmp_path):
    missing = invoke("train", "--from", tmp_path, "--out", tmp_path / "run")
    assert missing.exit_code == 1
    assert f"{tmp_path}: no dataset of this robot" in missing.output
    assert "write one with `softarm logs export --to lerobot`" in missing.output
    shelf = invoke("train", "shelf", "--from", dataset, "--out", tmp_path / "run")
    assert "task 'shelf': the episodes have reach goals" in shelf.output
    single = replace(lerobot.read(dataset)[0], reached=True)
    lerobot.write(tmp_path / "one", [single])
    few = invoke("train", "--from", tmp_path / "one", "--out", tmp_path / "run")
    assert f"{tmp_path / 'one'}: usable episodes: 1; allowed 2 or more: record more flights" in few.output


def test_a_dataset_of_another_robot_is_refused(dataset, tmp_path):
    info = json.loads((dataset / "meta/info.json").read_text())
    (tmp_path / "meta").mkdir()
    for change, said in (
        ({"fps": 50}, "50 frames a second"),
        ({"codebase_version": "v1.6"}, "has v1.6"),
        ({"features": {**info["features"], "action": {"names": ["gripper"]}}}, "'action': ('gripper',)"),
    ):
        (tmp_path / "meta/info.json").write_text(json.dumps(info | change))
        with pytest.raises(ValueError, match="allowed v3") as refused:
            lerobot.read(tmp_path)
        assert said in str(refused.value)
