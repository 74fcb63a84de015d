"""Train a policy on, on another simulator, for minutes: how, and what came of it.

Not on that simulator alone: no diagnosis is exact, so the robots that it is trained on lie around the model.
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
from softarm.training.learn.inference import workers
from softarm.training.learn.ppo import PpoConfig
from softarm.training.record.curve import Iteration
from softarm.training.record.export import export_checkpoint
from softarm.training.run import validation, warm_start
from softarm.training.run.session import Session, Standing
from softarm.training.run.settings import TrainingConfig
from softarm.training.task.randomisation import Randomisation

# What a bench leaves open where the model says nothing of it.
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
    """How a policy is trained on. `python -m softarm.benchmarks.retraining` compares some, on the validation set."""

    frames: int = 2_000_000
    seconds: float = 120.0  # at most, whatever the frames
    robots: int = 2048
    validate_every: int = 20
    validation_trials: int = 1536
    std: float = warm_start.STD
    critic_iterations: int = warm_start.CRITIC_ITERATIONS
    learning_rate: float = 1e-3
    spread: float = 0.1  # robots differ by this share of every effect's values, and by what is open; 0: not at all
    seed: int = 1


@dataclass(frozen=True)
class Retrained:
    """What training on came to. Shares of the validation set, on robots such as it was trained on."""

    policy: Path
    frames: int
    seconds: float
    before: float
    after: float
    curve: tuple[Iteration, ...]

    @property
    def better(self) -> bool:
        """Whether the new policy is worth flying, by the validation set."""
        return self.after > self.before


def around(model: Model, spread: float) -> Randomisation:
    """Robots around a model, another one every episode; none where the spread is 0."""
    if spread == 0:
        return Randomisation()
    ranges = {}
    for name, values in model.effects.items():
        for key, value in values.items():
            if math.isfinite(value):  # else it is none
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
    tell: Callable[[str, float], None],
    limits: RailLimits | None = None,
) -> Retrained:
    """Train a policy on, on a model recorded under `name`; writes out/retrained.onnx, .pt and out/training/.

    tell(what, share done). limits: that the robot's daemon holds the rail to; without, those it was trained under
    before. Raises CheckpointError for a policy that training did not write.
    """
    started = time.monotonic()
    prior = warm_start.load_weights(policy)
    if limits is not None:
        prior = replace(prior, task=prior.task.under(limits))
    training = TrainingConfig(
        config.seed,
        config.robots,
        validate_every=config.validate_every,
        validation_trials=config.validation_trials,
    )
    ppo, robots = PpoConfig(learning_rate=config.learning_rate), around(model, config.spread)
    with workers() as pool:
        tell("flying the old policy in validation", 0.0)
        scenarios = validation.validation_scenarios(prior.task, model.arm.links, config.validation_trials)
        flown = validation.fly(
            prior.network, prior.task, scenarios, pool, training.physics_rate_hz, model, randomisation=robots
        )
        before = flown.reached.mean()
        session = Session(
            prior.task, training, ppo, out / "training", pool, False, model, name, robots, prior.network.shape
        )
        tell("fitting the critic", 0.0)
        warm_start.begin(session, prior, config.std, config.critic_iterations)

        def standing(now: Standing) -> None:
            best = "" if now.best is None else f", validation {now.best:.1%}"
            share = max(now.frames / config.frames, now.seconds / config.seconds)
            tell(f"retraining, {now.frames / 1e6:.2f} M frames{best}", min(1.0, share))

        session.seconds = time.monotonic() - started  # what came before counts
        standing(session.advance())  # at least one, however slow the machine
        session.run(config.frames, config.seconds / 60.0, standing)
    best = out / "training" / "best.pt"
    export_checkpoint(best, out / "retrained.onnx")
    shutil.copyfile(best, out / "retrained.pt")
    (out / "training" / f"{prior.task.name}.onnx").unlink()  # the same file as retrained.onnx
    assert session.best is not None  # the last iteration is always validated
    return Retrained(
        out / "retrained.onnx", session.frames, session.seconds, float(before), session.best, tuple(session.curve)
    )
