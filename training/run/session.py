"""A training run from its settings to the exported policy: learn, validate, keep checkpoints, stop."""

import copy
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from softarm.schemas.model import Model
from softarm.training.learn.inference import Workers, device_named
from softarm.training.learn.network import NetworkShape, PolicyNetwork
from softarm.training.learn.ppo import Ppo, PpoConfig
from softarm.training.record import curve, export
from softarm.training.record.tensorboard import EventFile
from softarm.training.run import checkpoint
from softarm.training.run.settings import DTYPES, TrainingConfig, recorded
from softarm.training.run.validation import Validation, validation_scenarios
from softarm.training.task.environment import ACTIONS
from softarm.training.task.randomisation import Randomisation
from softarm.training.task.reach import ReachTask
from softarm.training.task.shelf import environment_of

YOUNG = 10  # the average remembers at most a tenth of a run's age, so that untrained weights are soon forgotten


@dataclass(frozen=True)
class Standing:
    """Where a run stands after an iteration."""

    frames: int  # control steps of single robots
    seconds: float
    frames_per_s: float  # of the last iteration
    success: float  # of the episodes that ended, with exploration noise
    reward: float
    validation: float | None  # newest
    best: float | None

    @property
    def sentence(self) -> str:
        """For people who watch."""
        validation = "-" if self.validation is None else f"{self.validation:.1%}, best {self.best:.1%}"
        return (
            f"{self.frames / 1e6:.1f} M frames, {self.frames_per_s / 1e3:.0f} k/s, "
            f"reward {self.reward:.2f}, valid {validation}"
        )


class Session:
    """One run. Files in `out`: latest.pt, best.pt, learning_curve.csv and .png, tensorboard/, at the end the policy.

    It says when to learn, to validate, to keep a checkpoint and to stop; how is the learner's, `Validation`'s,
    checkpoint.py's, curve.py's and export.py's.
    """

    def __init__(
        self,
        task: ReachTask,
        config: TrainingConfig,
        ppo: PpoConfig,
        out: Path,
        pool: Workers,
        resume: bool,
        model: Model | None = None,
        model_name: str = "seed",
        randomisation: Randomisation | None = None,
        shape: NetworkShape | None = None,
    ) -> None:
        """Train on a model (default: the seed's), under whose name it is recorded, on robots that differ as given.

        shape: the network's, whose numbers of inputs and actions are the task's.

        Raises CheckpointError when there is nothing to resume, or it was made with other settings, ValueError when the
        device is not here.
        """
        self.task, self.config, self.ppo, self.out, self.pool = task, config, ppo, out, pool
        saved = checkpoint.load(out / "latest.pt") if resume else None
        device = device_named(config.device)
        products = config.products_on(device)
        self.model, robots = model or Model(), randomisation or Randomisation()
        rate_hz = config.physics_rate_hz
        environment = environment_of(task, config.robots, config.seed, self.model, rate_hz, robots)
        shape = replace(shape or NetworkShape(), inputs=environment.inputs, actions=ACTIONS)
        as_run = replace(config, matrix_products=products)
        self.settings = recorded(task, as_run, ppo, robots, shape, self.model, model_name)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            self.network = PolicyNetwork(shape).to(device)
        # What is validated and exported: single iterations jitter around it.
        self.average = copy.deepcopy(self.network)
        scenarios = validation_scenarios(task, environment.simulator.links, config.validation_trials)
        self._validation = Validation(task, scenarios, pool, rate_hz, self.model, DTYPES[products], robots)
        self.learner = Ppo(self.network, environment, ppo, pool, config.seed, DTYPES[products])
        self.frames, self.seconds = 0, 0.0
        self.curve: list[curve.Iteration] = []
        self.events = EventFile(out / "tensorboard")
        if saved is not None:
            checkpoint.restore(self, saved)

    @property
    def title(self) -> str:
        """For people."""
        model = self.settings["model.name"]
        return f"{self.task.name}{'' if model == 'seed' else f' on {model}'}, seed {self.config.seed}"

    @property
    def best(self) -> float | None:
        """Share of the validation set that the best weights so far reached; None before the first validation."""
        return max(curve.validated(self.curve), default=None)

    def run(self, frames: int | None, minutes: float | None, tell: Callable[[Standing], None] = lambda _: None) -> Path:
        """Train up to so many frames or minutes in all (what was resumed counts), or until patience ends; returns the
        exported policy's path.

        Raises ValueError without either bound.
        """
        if frames is None and minutes is None:
            raise ValueError("give the run an end: frames or minutes")
        try:
            while (frames is None or self.frames < frames) and (minutes is None or self.seconds < 60.0 * minutes):
                if self.config.patience and curve.fruitless(self.curve) >= self.config.patience:
                    break
                tell(self.advance())
            if self.curve and self.curve[-1].validation is None:
                self._validate_and_save()
        finally:
            self.events.close()
        curve.write_png(self.curve, self.out / "learning_curve.png", self.title)
        return self.export_best()

    def advance(self) -> Standing:
        """One iteration, and every so often a validation and a checkpoint."""
        start = time.monotonic()
        statistics = self.learner.iterate()
        self.average.follow(self.network, averaged_share(len(self.curve), self.config.averaging))
        took = time.monotonic() - start
        steps = self.config.robots * self.ppo.horizon
        self.frames += steps
        self.seconds += took
        row = curve.Iteration(len(self.curve) + 1, self.frames, self.seconds, steps / took, **statistics._asdict())
        self.curve.append(row)
        self.events.add(self.curve)
        if len(self.curve) % self.config.validate_every == 0:
            self._validate_and_save()
            self.seconds += time.monotonic() - start - took
        newest = next(reversed(curve.validated(self.curve)), None)
        return Standing(
            self.frames, self.seconds, row.frames_per_s, statistics.success, statistics.reward, newest, self.best
        )

    def export_best(self) -> Path:
        """Write the policy of the checkpoint that did best in validation."""
        policy = self.out / f"{self.task.name}.onnx"
        export.export_checkpoint(self.out / "best.pt", policy)
        return policy

    def _validate_and_save(self) -> None:
        before, success = self.best, self._validation.success(self.average)
        self.curve[-1] = self.curve[-1]._replace(validation=success)
        self.events.add_validation(self.curve[-1])
        if before is None or success > before:
            checkpoint.save(self.out / "best.pt", checkpoint.policy_of(self))
        checkpoint.save(self.out / "latest.pt", checkpoint.all_of(self))
        curve.write_csv(self.curve, self.out / "learning_curve.csv")


def averaged_share(iterations: int, averaging: float) -> float:
    """How much of the newest weights goes into their average, after so many iterations before."""
    return max(1.0 - averaging, YOUNG / (YOUNG + iterations))
