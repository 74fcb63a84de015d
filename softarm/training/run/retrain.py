"""Retraining of a policy on another simulator, for minutes, from the weights in its file.

The ONNX file holds the actor and its normaliser exactly, but neither critic nor exploration noise. So the critic is
fitted to the fixed actor before training continues. No diagnosis is exact, so the simulated robots vary around the
patched model.
"""

import math
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from pydantic import ValidationError
from torch import Tensor

from softarm.schemas.config import RailLimits
from softarm.schemas.model import Model
from softarm.schemas.policy import METADATA_KEY, PolicyMetadata
from softarm.simulator.effects import find
from softarm.training.learn import validation
from softarm.training.learn.inference import workers
from softarm.training.learn.network import VARIANCE_FLOOR, NetworkShape, PolicyNetwork
from softarm.training.learn.ppo import Ppo, PpoConfig
from softarm.training.record.checkpoint import CheckpointError, TrainingConfig, task_of
from softarm.training.record.curve import Iteration
from softarm.training.record.export import export_checkpoint
from softarm.training.run.session import Session
from softarm.training.task.environment import Randomisation
from softarm.training.task.reach import ReachTask

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
    missing or was written by another program, or if the packages lack its task.
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
    except (StopIteration, KeyError, TypeError, ValueError, RuntimeError, ValidationError) as error:
        reason = str(error).partition("\n")[0] or "without metadata"
        raise CheckpointError(f"{path}: not a policy of `softarm train` ({reason}); name one of its files") from error
    return Prior(network, _task(path, metadata), metadata)


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


def _task(path: Path, metadata: PolicyMetadata) -> ReachTask:
    """Return the task with the settings of its training. Raises CheckpointError."""
    given = {key.partition(".")[2]: value for key, value in metadata.training.items() if key.startswith("task.")}
    fields = {key: tuple(v) if isinstance(v, list) else v for key, v in given.items()}
    return task_of(path, {"kind": metadata.task, "task": fields})


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


# Ranges of the parameters that a model may leave out.
OPEN = {
    "rail.lag.time": (0.0, 0.01),
    "arm.stiffness.scale": (-0.1, 0.1),
    "arm.damping.scale": (-0.2, 0.2),
    "arm.muscle_gain.scale": (-0.1, 0.1),
    "mocap.latency.delay": (0.0, 0.01),
    "mocap.noise.sigma": (0.0, 0.0006),
}


@dataclass(frozen=True)
class RetrainingConfig:
    """Recipe of a retraining; docs/evidence/close-gap.md compares several on the validation set."""

    frames: int = 2_000_000
    frames_min: int = 200_000  # fewer than a tenth of the recipe change the policy too little to compare it
    seconds: float = 120.0  # upper bound
    robots: int = 2048
    validate_every: int = 20
    validation_trials: int = 1536
    std: float = STD
    critic_iterations: int = CRITIC_ITERATIONS
    learning_rate: float = 1e-3
    spread: float = 0.1  # relative spread of every effect's values, and OPEN is used; 0: all robots are the model
    seed: int = 1


@dataclass(frozen=True)
class Retrained:
    """Result of a retraining; shares are of the validation set, on robots like those of the training."""

    policy: Path
    frames: int
    seconds: float
    before: float
    after: float
    curve: tuple[Iteration, ...]

    @property
    def better(self) -> bool:
        """Whether the new policy is better in the validation set."""
        return self.after > self.before


def around(model: Model, spread: float) -> Randomisation:
    """Return robots that vary around a model in every episode; without variation if the spread is 0."""
    if spread == 0:
        return Randomisation()
    ranges = {}
    for name, values in model.effects.items():
        for key, value in values.items():
            if math.isfinite(value):
                path = f"{name}.{key}"
                allowed = find(path)[1]
                low, high = sorted(((1 - spread) * value, (1 + spread) * value))
                ranges[path] = (max(low, allowed.low), min(high, allowed.high))
    unsaid = {path: ends for path, ends in OPEN.items() if path.rpartition(".")[0] not in model.effects}
    return Randomisation(ranges | unsaid, each_episode=True)


def retrain(
    policy: Path,
    model: Model,
    name: str,
    out: Path,
    config: RetrainingConfig,
    on_progress: Callable[[str, float], None],
    limits: RailLimits | None = None,
) -> Retrained:
    """Retrain a policy and write out/retrained.onnx, out/retrained.pt and out/training/.

    Args:
        policy: ONNX file of `softarm train`.
        model: Model to train on; `name` is recorded for it.
        limits: Rail limits of the daemon that will fly; default: those of the earlier training.

    Raises:
        CheckpointError: The policy was not written by training.
        ValueError: Time or frames suffice for less than `config.frames_min` frames.
    """
    started = time.monotonic()
    prior = load_weights(policy)
    if limits is not None:
        prior = replace(prior, task=prior.task.under(limits))
    every, trials = config.validate_every, config.validation_trials
    training = TrainingConfig(config.seed, config.robots, validate_every=every, validation_trials=trials)
    ppo, robots = PpoConfig(learning_rate=config.learning_rate), around(model, config.spread)
    with workers() as pool:
        on_progress("flying the old policy in validation", 0.0)
        scenarios = validation.validation_scenarios(prior.task, model.arm.links, trials)
        flown = validation.fly(
            prior.network, prior.task, scenarios, pool, training.physics_rate_hz, model, randomisation=robots
        )
        before = flown.reached.mean()
        session = Session(
            prior.task, training, ppo, out / "training", pool, False, model, name, robots, prior.network.shape
        )
        on_progress("fitting the critic", 0.0)
        begin(session, prior, config.std, config.critic_iterations)

        def report() -> None:
            best = "" if session.best is None else f", validation {session.best:.1%}"
            share = session.finished(config.frames, config.seconds / 60.0)
            on_progress(f"retraining, {session.frames / 1e6:.2f} M frames{best}", share)

        # The time of validation and critic counts.
        session.seconds = time.monotonic() - started
        session.advance()
        report()
        _check_length(session, config)
        session.run(config.frames, config.seconds / 60.0, report)
    best = out / "training" / "best.pt"
    export_checkpoint(best, out / "retrained.onnx")
    shutil.copyfile(best, out / "retrained.pt")
    # The same file as retrained.onnx.
    (out / "training" / f"{prior.task.name}.onnx").unlink()
    assert session.best is not None, "the last iteration is always validated"
    return Retrained(
        out / "retrained.onnx", session.frames, session.seconds, float(before), session.best, tuple(session.curve)
    )


def _check_length(session: Session, config: RetrainingConfig) -> None:
    """Raise ValueError if the time left after the first iteration is too short for the least number of frames."""
    frames, seconds, frames_per_s = session.frames, session.seconds, session.curve[-1].frames_per_s
    expected = min(frames + frames_per_s * max(0.0, config.seconds - seconds), config.frames)
    if expected < config.frames_min:
        needed_s = seconds + (config.frames_min - frames) / frames_per_s
        raise ValueError(
            f"{config.seconds:g} s of retraining allow about {expected / 1e6:.2f} M frames on this computer; at least "
            f"{config.frames_min / 1e6:.2f} M are needed: give --seconds {math.ceil(needed_s / 10) * 10} or more"
        )
