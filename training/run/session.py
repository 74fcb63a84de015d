"""A training run from its settings to the exported policy: learn, validate, keep checkpoints, stop."""

import copy
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch

from softarm.schemas.model import Model
from softarm.schemas.policy import ACTION
from softarm.schemas.robot import TRAINING_PHYSICS_RATE_HZ
from softarm.simulator import model_file
from softarm.training.learn.inference import Workers, device_named, quick_dtype
from softarm.training.learn.network import NetworkShape, PolicyNetwork
from softarm.training.learn.ppo import Ppo, PpoConfig
from softarm.training.record import export, page, path_figure, report
from softarm.training.record.tensorboard import EventFile
from softarm.training.run import checkpoint, validation
from softarm.training.run.checkpoint import CheckpointError
from softarm.training.task.environment import ACTIONS
from softarm.training.task.randomisation import Randomisation
from softarm.training.task.reach import ReachTask
from softarm.training.task.shelf import ShelfTask, environment_of

YOUNG = 10  # the average remembers at most a tenth of a run's age, so that untrained weights are soon forgotten
DTYPES = {"float32": torch.float32, "bfloat16": torch.bfloat16}


@dataclass(frozen=True)
class TrainingConfig:
    """What makes a run the run it is; two runs with the same settings on the same machine are the same."""

    seed: int = 1
    robots: int = 2048
    physics_rate_hz: float = TRAINING_PHYSICS_RATE_HZ
    validate_every: int = 20  # iterations; a checkpoint is kept as often
    validation_trials: int = 1536
    averaging: float = 0.975  # share of the averaged weights that an iteration leaves, in the long run
    patience: int = 0  # validations without a better one after which a run stops; 0: it goes on
    matrix_products: str = "auto"  # float32, bfloat16, or auto: bfloat16 where the processor has it
    device: str = "cpu"  # where the network learns, cpu or cuda; the robots are the CPU's


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
    """One run. Files in `out`: latest.pt, best.pt, learning_curve.csv and .png, tensorboard/, at the end the policy,
    and with `test` and `write_report` report.html and tip_paths.png.
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
        self.task, self.config, self.ppo, self.out, self._pool = task, config, ppo, out, pool
        saved = checkpoint.load(out / "latest.pt") if resume else None
        device = device_named(config.device)
        self._products = _quick_products(device) if config.matrix_products == "auto" else config.matrix_products
        self._randomisation = randomisation or Randomisation()
        self.model = model or Model()
        environment = environment_of(
            task, config.robots, config.seed, self.model, config.physics_rate_hz, self._randomisation
        )
        self._shape = replace(shape or NetworkShape(), inputs=environment.inputs, actions=ACTIONS)
        self.settings = _settings(task, config, ppo, self._randomisation, self._shape)
        self.settings["run.matrix_products"] = self._products
        self.settings |= _identity(self.model, model_name)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            self.network = PolicyNetwork(self._shape).to(device)
        # What is validated and exported: single iterations jitter around it.
        self.average = copy.deepcopy(self.network)
        self._trials = validation.validation_trials(task, environment.simulator.links, config.validation_trials)
        self.learner = Ppo(self.network, environment, ppo, pool, config.seed, DTYPES[self._products])
        self.frames, self.seconds = 0, 0.0
        self.curve: list[report.Row] = []
        self.best: float | None = None
        self.events = EventFile(out / "tensorboard")
        if saved is not None:
            self._restore(saved)

    @property
    def title(self) -> str:
        """For people."""
        model = self.settings["model.name"]
        return f"{self.task.name}{'' if model == 'seed' else f' on {model}'}, seed {self.config.seed}"

    def run(self, frames: int | None, minutes: float | None, tell: Callable[[Standing], None] = lambda _: None) -> Path:
        """Train up to so many frames or minutes in all (what was resumed counts), or until patience ends; returns the
        exported policy's path.

        Raises ValueError without either bound.
        """
        if frames is None and minutes is None:
            raise ValueError("give the run an end: frames or minutes")
        try:
            while (frames is None or self.frames < frames) and (minutes is None or self.seconds < 60.0 * minutes):
                if self.config.patience and self._fruitless() >= self.config.patience:
                    break
                tell(self.advance())
            if self.curve and self.curve[-1].validation is None:
                self._validate_and_save()
        finally:
            self.events.close()
        report.write_png(self.curve, self.out / "learning_curve.png", self.title)
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
        self.curve.append(
            report.Row(len(self.curve) + 1, self.frames, self.seconds, steps / took, **statistics._asdict())
        )
        self.events.add(self.curve)
        if len(self.curve) % self.config.validate_every == 0:
            self._validate_and_save()
            self.seconds += time.monotonic() - start - took
        validation = next((row.validation for row in reversed(self.curve) if row.validation is not None), None)
        return Standing(
            self.frames,
            self.seconds,
            steps / took,
            statistics.success,
            statistics.reward,
            validation,
            self.best,
        )

    def export_best(self) -> Path:
        """Write the policy of the checkpoint that did best in validation."""
        path = self.out / f"{self.task.name}.onnx"
        export_checkpoint(self.out / "best.pt", path)
        return path

    def test(self) -> validation.Tested:
        """Fly the task's test trials with the exported policy, for the record; nothing is chosen by it."""
        network, _ = load_policy(self.out / "best.pt")
        if isinstance(self.task, ShelfTask):
            return validation.shelf_test(network, self.task, self._pool, model=self.model)
        return validation.grid_test(network, self.task, self._pool, model=self.model)

    def write_report(self, tested: validation.Tested) -> Path:
        """Leave report.html and tip_paths.png beside the curve that `run` drew; returns the page's path."""
        path_figure.write_png(tested, self.task, self.out / "tip_paths.png", self.title)
        best = next(row for row in self.curve if row.validation is not None and row.validation == self.best)
        usual = self._usual() | {"run.matrix_products": _quick_products(self.network.device)}
        summary = page.Summary(
            title=self.title,
            task=self.task.name,
            model=str(self.settings["model.name"]),
            seed=self.config.seed,
            frames=self.frames,
            seconds=self.seconds,
            best=best.validation or 0.0,
            best_frames=best.frames,
            chosen_by=_chosen_by(self.task),
            test=tested.report.sentence,
            changed=page.changed(self.settings, usual),
        )
        pictures = ((self.out / name).read_bytes() for name in ("learning_curve.png", "tip_paths.png"))
        path = self.out / "report.html"
        path.write_text(page.render(summary, *pictures), encoding="utf-8")
        return path

    def _fruitless(self) -> int:
        """Validations since the best one."""
        validated = [row.validation for row in self.curve if row.validation is not None]
        return len(validated) - 1 - validated.index(max(validated)) if validated else 0

    def _validate_and_save(self) -> None:
        outcome = validation.fly(
            self.average,
            self.task,
            self._trials,
            self._pool,
            self.config.physics_rate_hz,
            self.model,
            DTYPES[self._products],
            self._randomisation,
        )
        success = float(outcome.reached.mean())
        self.curve[-1] = self.curve[-1]._replace(validation=success)
        self.events.add_validation(self.curve[-1])
        if self.best is None or success > self.best:
            self.best = success
            checkpoint.save(self.out / "best.pt", self._description())
        checkpoint.save(self.out / "latest.pt", self._description() | {"learner": self.learner.snapshot()})
        report.write_csv(self.curve, self.out / "learning_curve.csv")

    def _description(self) -> dict[str, Any]:
        return {
            "settings": self.settings,
            "average": self.average.state_dict(),
            "network": asdict(self._shape),
            "kind": self.task.kind,
            "task": asdict(self.task),
            "seed": self.config.seed,
            "frames": self.frames,
            "seconds": self.seconds,
            "best": self.best,
            "curve": [tuple(row) for row in self.curve],
        }

    def _usual(self) -> export.Settings:
        """The settings of a run of which nothing was asked but the kind of its task."""
        shape = NetworkShape(inputs=self._shape.inputs, actions=ACTIONS)
        usual = _settings(type(self.task)(), TrainingConfig(), PpoConfig(), Randomisation(), shape)
        return usual | _identity(Model(), "seed")

    def _restore(self, saved: dict[str, Any]) -> None:
        settings = self._usual() | saved["settings"]  # older ones knew no other model, network or robots that differ
        for key, value in self.settings.items():
            if settings.get(key) != value:
                raise CheckpointError(
                    f"{self.out / 'latest.pt'}: was trained with {key} = {settings.get(key)}, not {value}; "
                    "resume with the same settings or give another --out"
                )
        self.learner.restore(saved["learner"])
        self.average.load_state_dict(saved["average"])
        self.frames, self.seconds, self.best = saved["frames"], saved["seconds"], saved["best"]
        self.curve = [report.Row(*row) for row in saved["curve"]]


def averaged_share(iterations: int, averaging: float) -> float:
    """How much of the newest weights goes into their average, after so many iterations before."""
    return max(1.0 - averaging, YOUNG / (YOUNG + iterations))


def export_checkpoint(source: Path, target: Path) -> None:
    """Turn a checkpoint of a session into an ONNX policy named after its task. Raises CheckpointError."""
    network, saved = load_policy(source)
    task = task_of(saved)
    if not task.muscle:
        _vent(network)
    validated = [row for row in map(report.Row._make, saved["curve"]) if row.validation is not None]
    description = export.metadata(
        network,
        task,
        saved["settings"] | {"run.frames": saved["frames"], "run.validation_set": _chosen_by(task)},
        saved["seed"],
        validated[-1].validation if validated and validated[-1].validation is not None else 0.0,
    )
    export.write(network, description, target)


def _quick_products(device: torch.device) -> str:
    return str(quick_dtype(device)).removeprefix("torch.")


def _chosen_by(task: ReachTask) -> str:
    return validation.SHELF_VALIDATION_SET if isinstance(task, ShelfTask) else validation.VALIDATION_SET


def _identity(model: Model, name: str) -> export.Settings:
    return {"model.name": name, "model.sha256": model_file.fingerprint(model)}


def load_policy(source: Path) -> tuple[PolicyNetwork, dict[str, Any]]:
    """Return the network of a session's checkpoint, and all else that is in the file. Raises CheckpointError."""
    saved = checkpoint.load(source)
    missing = {"settings", "task", "seed", "curve", "average"} - saved.keys()
    if missing:
        raise CheckpointError(f"{source}: {', '.join(sorted(missing))} missing; give a .pt file of `softarm train`")
    network = PolicyNetwork(NetworkShape(**saved.get("network", {})))
    network.load_state_dict(saved["average"])
    return network, saved


def task_of(saved: dict[str, Any]) -> ReachTask:
    """The task of a checkpoint."""
    kind = ShelfTask if saved.get("kind") == "shelf" else ReachTask
    return kind(**saved["task"])


def _settings(
    task: ReachTask, config: TrainingConfig, ppo: PpoConfig, randomisation: Randomisation, shape: NetworkShape
) -> export.Settings:
    return export.flat_settings(task=task, run=config, ppo=ppo, randomise=randomisation, network=shape)


def _vent(network: PolicyNetwork) -> None:
    """Have a network whose muscle was never used say so: its pressure stays at 0."""
    low, high = ACTION[1].low, ACTION[1].high
    assert low is not None
    assert high is not None
    with torch.no_grad():
        network.mean_head.weight[1] = 0.0
        network.mean_head.bias[1] = -2.0 * low / (high - low) - 1.0
