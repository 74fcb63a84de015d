"""Start of a training run from a policy's file: its weights are read, and a new critic is fitted.

The ONNX file holds the actor and its normaliser exactly, but neither critic nor exploration noise. So the critic is
fitted to the fixed actor before training continues.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from pydantic import ValidationError
from torch import Tensor

from softarm.schemas.policy import METADATA_KEY, PolicyMetadata
from softarm.training.learn.network import NetworkShape, PolicyNetwork
from softarm.training.learn.normaliser import VARIANCE_FLOOR
from softarm.training.learn.ppo import Ppo
from softarm.training.record.checkpoint import CheckpointError
from softarm.training.run.session import Session
from softarm.training.task.reach import ReachTask
from softarm.training.task.registry import rebuilt

CRITIC_ITERATIONS = 8
CRITIC_RATE = 3e-3  # of the value head alone, a linear fit
# Exploration noise on the +-1 actions. With half of it the policy hardly changes (docs/gap/close-gap.md).
STD = 0.85


@dataclass(frozen=True)
class Prior:
    """Policy from which training continues."""

    network: PolicyNetwork
    task: ReachTask
    metadata: PolicyMetadata


def load_weights(path: Path) -> Prior:
    """Read a policy of `training/record/export.py`; a second export has the same weights, bit for bit.

    Value head, value statistics and exploration noise are those of a new network. Raises CheckpointError if the file is
    missing or was written by another program.
    """
    try:
        model = onnx.load(path)
    except FileNotFoundError:
        raise CheckpointError(f"{path}: no such policy; name an .onnx file of `softarm train`") from None
    except Exception as error:  # a damaged file makes protobuf raise many types
        raise CheckpointError(f"{path}: not an ONNX file ({error}); name one of `softarm train`") from error
    try:
        text = next(prop.value for prop in model.metadata_props if prop.key == METADATA_KEY)
        metadata = PolicyMetadata.model_validate_json(text)
        values = {item.name: torch.from_numpy(numpy_helper.to_array(item).copy()) for item in model.graph.initializer}
        network = _network(values, metadata)
    except (StopIteration, KeyError, ValueError, RuntimeError, ValidationError) as error:
        reason = str(error).partition("\n")[0] or "without metadata"
        raise CheckpointError(f"{path}: not a policy of `softarm train` ({reason}); name one of its files") from error
    return Prior(network, _task(metadata), metadata)


def begin(session: Session, prior: Prior, std: float = STD, critic_iterations: int = CRITIC_ITERATIONS) -> None:
    """Give a new session the weights of a policy, and fit its critic while the actor is fixed."""
    with torch.no_grad():
        kept = {name for name, _ in prior.network.named_parameters() if not name.startswith(("value_head", "log_std"))}
        kept |= {f"observation_normaliser.{name}" for name in ("mean", "variance", "count")}
        weights = {name: value for name, value in prior.network.state_dict().items() if name in kept}
        session.network.load_state_dict(session.network.state_dict() | weights)
        session.network.log_std.fill_(float(np.log(std)))
    session.settings |= {
        "start.frames": int(_frames(prior.metadata)),
        "start.git_revision": prior.metadata.git_revision,
        "start.std": std,
        "start.critic_iterations": critic_iterations,
    }
    learner = session.learner
    assert isinstance(learner, Ppo)
    rate = learner.learning_rate
    learner.learning_rate = CRITIC_RATE
    for _ in range(critic_iterations):
        learner.iterate(critic_only=True)
    learner.learning_rate = rate
    session.average.load_state_dict(session.network.state_dict())


def _frames(metadata: PolicyMetadata) -> float:
    """Return the number of observations in the normaliser, which is the weight of the past."""
    given = (metadata.training.get(key) for key in ("run.frames", "start.frames"))
    return float(sum(value for value in given if isinstance(value, int | float)))


def _task(metadata: PolicyMetadata) -> ReachTask:
    """Return the task with the settings of its training."""
    given = {key.partition(".")[2]: value for key, value in metadata.training.items() if key.startswith("task.")}
    return rebuilt(metadata.task, {key: tuple(v) if isinstance(v, list) else v for key, v in given.items()})


def _network(values: dict[str, Tensor], metadata: PolicyMetadata) -> PolicyNetwork:
    """Build the network from the weights; inverse of `softarm.training.record.export.onnx_model`."""
    mlp = tuple(values[f"mlp_{k}_weight"].shape[0] for k in range(sum(f"mlp_{k}_weight" in values for k in range(99))))
    inputs, actions = values["observation_mean"].shape[0], values["head_weight"].shape[0]
    # A file without the order has the default one.
    order: Any = metadata.training.get("network.order", NetworkShape.order)
    network = PolicyNetwork(NetworkShape(inputs, actions, mlp, metadata.state_size, order))
    state = {
        "observation_normaliser.mean": values["observation_mean"].double(),
        "observation_normaliser.variance": values["observation_scale"].double() ** 2 - VARIANCE_FLOOR,
        "observation_normaliser.count": torch.tensor(_frames(metadata), dtype=torch.float64),
        "mean_head.weight": values["head_weight"],
        "mean_head.bias": values["head_bias"],
    }
    linear = [name for name, module in network.mlp.named_children() if isinstance(module, torch.nn.Linear)]
    for k, name in enumerate(linear):
        state |= {f"mlp.{name}.{part}": values[f"mlp_{k}_{part}"] for part in ("weight", "bias")}
    if order != "mlp":
        state |= {
            "w_x": _from_onnx_gates(values["lstm_w"][0]),
            "w_h": _from_onnx_gates(values["lstm_r"][0]),
            "bias": _from_onnx_gates(values["lstm_b"][0].chunk(2)[0]),
            "layer_norm.weight": values["norm_scale"],
            "layer_norm.bias": values["norm_bias"],
        }
    network.load_state_dict(network.state_dict() | state)
    return network


def _from_onnx_gates(values: Tensor) -> Tensor:
    i, o, f, g = values.chunk(4)
    return torch.cat((i, f, g, o))
