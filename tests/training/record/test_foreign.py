"""Networks of other learners become files that the daemon flies, number for number."""

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from softarm.policies.onnx_policy import OnnxPolicy
from softarm.schemas.policy import ACTION
from softarm.training.record import foreign
from softarm.training.record.foreign import ForeignNetworkError
from softarm.training.task.reach import TASKS, ShelfTask

SHORT = replace(TASKS["reach"], episode_steps=20)
MEAN = np.array([0.1, 0, -0.2, 0.6, 0, 0, 0, 5.0, -0.2, 0.6], np.float32)
SCALE = np.array([0.1, 0.3, 0.2, 0.1, 1, 1, 0.3, 8.0, 0.1, 0.05], np.float32)


@pytest.fixture(autouse=True)
def _few_trials(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(foreign, "VALIDATION_TRIALS", 12)


def network(*between: nn.Module, inputs: int = 10) -> nn.Sequential:
    torch.manual_seed(1)
    return nn.Sequential(nn.Linear(inputs, 16), *between, nn.Linear(16, 2))


@pytest.mark.parametrize("layer", [nn.Tanh(), nn.ReLU(), nn.ELU(0.5), nn.Sigmoid(), nn.Identity()])
def test_the_file_computes_the_networks_actions(layer: nn.Module, tmp_path: Path) -> None:
    layers = network(layer)
    share = foreign.export(
        layers, tmp_path / "mine.onnx", SHORT, mean=MEAN, scale=SCALE, cut=2.0, training={"learner": "mine"}
    )
    policy = OnnxPolicy(str(tmp_path / "mine.onnx"))  # which replays its golden run
    assert policy.metadata.validation_success == share
    assert policy.metadata.training["learner"] == "mine"
    assert policy.metadata.training["task.name"] == "reach"
    low, high = (np.array([getattr(signal, end) for signal in ACTION]) for end in ("low", "high"))
    rng = np.random.default_rng(0)
    for _ in range(5):
        seen = (MEAN + 3 * SCALE * rng.standard_normal(10)).astype(np.float32)
        inside = torch.from_numpy(((seen - MEAN) / SCALE).clip(-2.0, 2.0))
        wanted = layers(inside).detach().numpy().clip(-1.0, 1.0)
        np.testing.assert_allclose(policy.step(seen[:8], seen[8:]), low + (wanted + 1) / 2 * (high - low), rtol=1e-4)


CARD = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a graphics card")


@pytest.mark.parametrize("to", [torch.float64, pytest.param("cuda", marks=CARD)])
def test_the_network_may_be_on_a_card_or_of_another_precision_and_stays_as_it_is(to: object, tmp_path: Path) -> None:
    layers = network(nn.Tanh()).to(to)
    before = copy.deepcopy(layers)
    foreign.export(layers, tmp_path / "mine.onnx", SHORT)
    assert OnnxPolicy(str(tmp_path / "mine.onnx")).metadata.name == "reach"
    for mine, theirs in zip(layers.parameters(), before.parameters(), strict=True):
        torch.testing.assert_close(mine, theirs, rtol=0.0, atol=0.0)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"scale": 0.0}, r"scale is 0\.0; allowed: one finite number or 10, above 0: correct it"),
        ({"scale": np.full(10, -1.0)}, "scale is .*-1.*; allowed: one finite number or 10, above 0"),
        ({"mean": np.zeros(8)}, "mean is .*0.*; allowed: one finite number or 10: correct it"),
        ({"mean": np.nan}, "mean is nan; allowed"),
        ({"mean": "many"}, "mean is 'many'; allowed"),
        ({"cut": -1.0}, r"cut is -1\.0; allowed: a number above 0, or infinity: correct it"),
        ({"cut": np.nan}, "cut is nan; allowed"),
    ],
)
def test_a_wrong_normalisation_is_refused(given: dict[str, object], text: str, tmp_path: Path) -> None:
    with pytest.raises(ForeignNetworkError, match=text):
        foreign.export(network(nn.Tanh()), tmp_path / "mine.onnx", SHORT, **given)
    assert not (tmp_path / "mine.onnx").exists()


def test_a_task_with_a_longer_observation_is_exported(tmp_path: Path) -> None:
    foreign.export(network(nn.Tanh(), inputs=11), tmp_path / "shelf.onnx", ShelfTask(episode_steps=20))
    assert OnnxPolicy(str(tmp_path / "shelf.onnx")).metadata.task == "shelf"


@pytest.mark.parametrize(
    ("layers", "text"),
    [
        (network(nn.GELU()), "layer 1 is a GELU; allowed are Linear, ELU, Tanh, ReLU"),
        (network(nn.Tanh(), inputs=11), r"layer 0, Linear\(in_features=11.*: allowed is a Linear with 10 inputs"),
        (nn.Sequential(nn.Linear(10, 3)), "the network gives 3 numbers; an action has 2"),
    ],
)
def test_an_unsupported_network_is_refused(layers: nn.Sequential, text: str, tmp_path: Path) -> None:
    with pytest.raises(ForeignNetworkError, match=text):
        foreign.export(layers, tmp_path / "mine.onnx")
    assert not (tmp_path / "mine.onnx").exists()
