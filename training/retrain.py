"""Train a policy on, on another simulator, for minutes: a recipe, and what came of it."""

import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from schemas.model import Model
from training import evaluation, warm_start
from training.inference import workers
from training.ppo import PpoConfig
from training.report import Row
from training.session import Session, Standing, TrainingConfig, export_checkpoint


@dataclass(frozen=True)
class Recipe:
    """How a policy is trained on. `python -m benchmarks.retraining` compares recipes, on the validation set."""

    frames: int = 2_000_000
    seconds: float = 120.0  # at most, whatever the frames
    robots: int = 2048
    validate_every: int = 20
    validation_trials: int = 1536
    std: float = warm_start.STD
    critic_iterations: int = warm_start.CRITIC_ITERATIONS
    learning_rate: float = 1e-3
    seed: int = 1


@dataclass(frozen=True)
class Retrained:
    """What training on came to. Shares of the validation set, on the model that it was trained on."""

    policy: Path
    frames: int
    seconds: float
    before: float
    after: float
    curve: tuple[Row, ...]

    @property
    def better(self) -> bool:
        """Whether the new policy is worth flying, by the validation set."""
        return self.after > self.before


def retrain(
    policy: Path, model: Model, name: str, out: Path, recipe: Recipe, tell: Callable[[str, float], None]
) -> Retrained:
    """Train a policy on, on a model recorded under `name`; writes out/retrained.onnx, .pt and out/training/.

    tell(what, share done). Raises CheckpointError for a policy that training did not write.
    """
    started = time.monotonic()
    prior = warm_start.load_weights(policy)
    config = TrainingConfig(
        recipe.seed,
        recipe.robots,
        validate_every=recipe.validate_every,
        validation_trials=recipe.validation_trials,
    )
    ppo = PpoConfig(learning_rate=recipe.learning_rate)
    with workers() as pool:
        tell("flying the old policy in validation", 0.0)
        trials = evaluation.validation_trials(prior.task, model.arm.links, recipe.validation_trials)
        before = evaluation.fly(prior.network, prior.task, trials, pool, config.physics_rate_hz, model).reached.mean()
        session = Session(prior.task, config, ppo, out / "training", pool, False, model, name)
        tell("fitting the critic", 0.0)
        warm_start.begin(session, prior, recipe.std, recipe.critic_iterations)

        def standing(now: Standing) -> None:
            best = "" if now.best is None else f", validation {now.best:.1%}"
            share = max(now.frames / recipe.frames, now.seconds / recipe.seconds)
            tell(f"retraining, {now.frames / 1e6:.2f} M frames{best}", min(1.0, share))

        session.seconds = time.monotonic() - started  # what came before counts
        standing(session.advance())  # at least one, however slow the machine
        session.run(recipe.frames, recipe.seconds / 60.0, standing)
    best = out / "training" / "best.pt"
    export_checkpoint(best, out / "retrained.onnx")
    shutil.copyfile(best, out / "retrained.pt")
    (out / "training" / f"{prior.task.name}.onnx").unlink()  # the same file as retrained.onnx
    assert session.best is not None  # the last iteration is always validated
    return Retrained(
        out / "retrained.onnx", session.frames, session.seconds, float(before), session.best, tuple(session.curve)
    )
