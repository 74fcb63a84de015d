"""Retraining of a policy on another simulator, for minutes.

No diagnosis is exact, so the simulated robots vary around the patched model.
"""

import math
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from softarm.schemas.config import RailLimits
from softarm.schemas.model import Model
from softarm.simulator.effects import find
from softarm.training.learn import validation
from softarm.training.learn.inference import workers
from softarm.training.learn.ppo import PpoConfig
from softarm.training.record.curve import Iteration
from softarm.training.record.export import export_checkpoint
from softarm.training.record.settings import TrainingConfig
from softarm.training.run import warm_start
from softarm.training.run.session import Session
from softarm.training.task.randomisation import Randomisation

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
    std: float = warm_start.STD
    critic_iterations: int = warm_start.CRITIC_ITERATIONS
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
    prior = warm_start.load_weights(policy)
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
        warm_start.begin(session, prior, config.std, config.critic_iterations)

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
