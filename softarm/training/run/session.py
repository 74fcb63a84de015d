"""Training session: learn, validate, save checkpoints, stop and export the policy."""

import copy
import time
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import torch

from softarm.schemas.model import Model
from softarm.training.learn.inference import device_named
from softarm.training.learn.network import NetworkShape, PolicyNetwork
from softarm.training.learn.ppo import Ppo, PpoConfig, Statistics
from softarm.training.learn.validation import fly, validation_scenarios
from softarm.training.record import checkpoint, curve, export
from softarm.training.record.checkpoint import DTYPES, TrainingConfig, recorded, usual
from softarm.training.record.curve import EventFile
from softarm.training.task.environment import ACTIONS, Environment, Randomisation
from softarm.training.task.reach import ReachTask
from softarm.training.task.registry import plugin_of
from softarm.training.task.tensor_environment import TensorEnvironment, environment_on

# The average spans at most a tenth of a run's age, so that untrained weights are soon forgotten.
YOUNG = 10
RESUMED = frozenset({"settings", "learner", "average", "frames", "seconds", "curve"})  # keys of latest.pt


class Learner(Protocol):
    """Learner of a session's network."""

    @property
    def frames(self) -> int:
        """Return the control steps of an iteration."""

    def iterate(self) -> Statistics:
        """Learn for one iteration."""

    def held_out_error(self, network: PolicyNetwork) -> float | None:
        """Return the action error of a network on held-out episodes, or None if the learner has no episodes."""

    def snapshot(self) -> dict[str, Any]:
        """Return the state for `restore`."""

    def restore(self, content: dict[str, Any]) -> None:
        """Restore the state of a snapshot."""


class Session:
    """Training run with its files in `out`.

    Files: latest.pt, best.pt, learning_curve.csv and .png, tensorboard/, and at the end the policy.
    """

    def __init__(
        self,
        task: ReachTask,
        config: TrainingConfig,
        ppo: PpoConfig,
        out: Path,
        pool: Executor,
        resume: bool,
        model: Model | None = None,
        model_name: str = "seed",
        randomisation: Randomisation | None = None,
        shape: NetworkShape | None = None,
    ) -> None:
        """Prepare a new run in `out`, or resume it from latest.pt there.

        The robots have the seed's model by default; `model_name` is recorded. The task determines the numbers of
        inputs and actions of `shape`.

        Raises:
            CheckpointError: The checkpoint to resume is missing or was made with other settings.
            ValueError: The device is not available.
        """
        self.task, self.config, self.ppo, self.out, self.pool = task, config, ppo, out, pool
        saved = checkpoint.load(out / "latest.pt", RESUMED) if resume else None
        device = device_named(config.device)
        products = config.products_on(device)
        if saved is not None and config.matrix_products == "auto":
            products = saved["settings"].get("run.matrix_products", products)
        self.model, robots = model or Model(), randomisation or Randomisation()
        rate_hz = config.physics_rate_hz
        environment = environment_on(device, task, config.robots, config.seed, self.model, rate_hz, robots)
        shape = replace(shape or NetworkShape(), inputs=environment.inputs, actions=ACTIONS)
        as_run = replace(config, matrix_products=products)
        self.settings = recorded(task, as_run, ppo, robots, shape, self.model, model_name)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            self.network = PolicyNetwork(shape).to(device)
        # What is validated and exported: single iterations jitter around it.
        self.average = copy.deepcopy(self.network)
        scenarios = validation_scenarios(task, environment.simulator.links, config.validation_trials)
        # The same scenarios every time, on robots like those of the training.
        self._fly_validation = partial(
            fly,
            task=task,
            scenarios=scenarios,
            pool=pool,
            physics_rate_hz=rate_hz,
            model=self.model,
            dtype=DTYPES[products],
            randomisation=robots,
        )
        self.learner = self._learner(environment, DTYPES[products])
        self.frames, self.seconds = 0, 0.0
        self.curve: list[curve.Iteration] = []
        self.events = EventFile(out / "tensorboard")
        if saved is not None:
            self._restore(saved)

    def _learner(self, environment: Environment | TensorEnvironment, dtype: torch.dtype) -> Learner:
        """Return the learner of the network; it may add to the settings."""
        return Ppo(self.network, environment, self.ppo, self.pool, self.config.seed, dtype)

    @property
    def title(self) -> str:
        """Task, model and seed for people."""
        model = self.settings["model.name"]
        return f"{self.task.name}{'' if model == 'seed' else f' on {model}'}, seed {self.config.seed}"

    @property
    def sentence(self) -> str:
        """Progress after the newest iteration for people."""
        row, shares = self.curve[-1], curve.validated(self.curve)
        validation = f"{shares[-1]:.1%}, best {max(shares):.1%}" if shares else "-"
        learned = f"reward {row.reward:.2f}" if row.action_error is None else f"action error {row.action_error:.3f}"
        return f"{row.frames / 1e6:.1f} M frames, {row.frames_per_s / 1e3:.0f} k/s, {learned}, valid {validation}"

    @property
    def exported(self) -> curve.Iteration:
        """Return the iteration whose checkpoint is exported; raise StopIteration before the first validation."""
        return next(row for row in self.curve if row.validation is not None and row.validation == self.best)

    @property
    def best(self) -> float | None:
        """Best validation success so far, as a share; None before the first validation."""
        return max(curve.validated(self.curve), default=None)

    def finished(self, frames: int | None, minutes: float | None) -> float:
        """Return the finished share of a run to these bounds, 0 to 1."""
        by_frames, by_time = (
            self.frames / frames if frames else 0.0,
            self.seconds / (60.0 * minutes) if minutes else 0.0,
        )
        return min(1.0, max(by_frames, by_time))

    def run(self, frames: int | None, minutes: float | None, on_progress: Callable[[], None] = lambda: None) -> Path:
        """Train until a bound or the patience is reached, and return the path of the exported policy.

        The bounds are control steps of single robots, and minutes; both include a run before a resume. `on_progress` is
        called after each iteration. Raises ValueError without any bound.
        """
        if frames is None and minutes is None:
            raise ValueError("the run has no end: give frames or minutes")
        try:
            while (frames is None or self.frames < frames) and (minutes is None or self.seconds < 60.0 * minutes):
                if self.config.patience and curve.fruitless(self.curve) >= self.config.patience:
                    break
                self.advance()
                on_progress()
            if self.curve and self.curve[-1].validation is None:
                self._validate_and_save()
        finally:
            self.events.close()
        curve.write_png(self.curve, self.out / "learning_curve.png", self.title)
        return self.export_best()

    def advance(self) -> None:
        """Learn for one iteration; at intervals also validate and save a checkpoint."""
        start = time.monotonic()
        statistics = self.learner.iterate()
        self.average.follow(self.network, averaged_share(len(self.curve), self.config.averaging))
        took = time.monotonic() - start
        steps = self.learner.frames
        self.frames += steps
        self.seconds += took
        figures = {**statistics._asdict(), "action_error": self.learner.held_out_error(self.average)}
        self.curve.append(curve.Iteration(len(self.curve) + 1, self.frames, self.seconds, steps / took, **figures))
        self.events.add(self.curve)
        if len(self.curve) % self.config.validate_every == 0:
            self._validate_and_save()
            self.seconds += time.monotonic() - start - took

    def export_best(self) -> Path:
        """Export the policy of the checkpoint with the best validation."""
        policy = self.out / f"{self.task.name}.onnx"
        export.export_checkpoint(self.out / "best.pt", policy)
        return policy

    def _validate_and_save(self) -> None:
        before, success = self.best, float(self._fly_validation(self.average).reached.mean())
        self.curve[-1] = self.curve[-1]._replace(validation=success)
        self.events.add_validation(self.curve[-1])
        if before is None or success > before:
            checkpoint.save(self.out / "best.pt", self._policy())
        checkpoint.save(self.out / "latest.pt", self._policy() | {"learner": self.learner.snapshot()})
        curve.write_csv(self.curve, self.out / "learning_curve.csv")

    def _policy(self) -> dict[str, Any]:
        """Return the averaged weights and how they were trained."""
        plugin = plugin_of(self.task)
        return {
            "settings": self.settings,
            "average": self.average.state_dict(),
            "network": asdict(self.network.shape),
            "kind": self.task.kind,
            "task": asdict(self.task) | ({} if plugin is None else {"plugin": plugin}),
            "seed": self.config.seed,
            "frames": self.frames,
            "seconds": self.seconds,
            "best": self.best,
            "curve": [tuple(row) for row in self.curve],
        }

    def _restore(self, saved: dict[str, Any]) -> None:
        """Continue from a checkpoint. Raises CheckpointError if it was made with other settings."""
        # Settings that a checkpoint leaves out have their usual values.
        settings = usual(self.task, self.network.shape.inputs) | saved["settings"]
        for key in self.settings | settings:
            before, now = settings.get(key), self.settings.get(key)
            if before != now:
                raise checkpoint.CheckpointError(
                    f"{self.out / 'latest.pt'}: was trained with {key} = {before}, not {now}; "
                    "resume with the same settings or give another --out"
                )
        self.learner.restore(saved["learner"])
        self.average.load_state_dict(saved["average"])
        self.frames, self.seconds = saved["frames"], saved["seconds"]
        self.curve = [curve.Iteration(*row) for row in saved["curve"]]


def averaged_share(iterations: int, averaging: float) -> float:
    """Return the share of the newest weights in their average after a number of iterations."""
    return max(1.0 - averaging, YOUNG / (YOUNG + iterations))
