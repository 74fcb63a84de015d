"""Settings of a run, under the names in its checkpoints and its policy."""

from dataclasses import asdict, dataclass

import torch

from softarm.schemas.model import Model
from softarm.schemas.robot import TRAINING_PHYSICS_RATE_HZ
from softarm.simulator import model_file
from softarm.training.learn.network import NetworkShape
from softarm.training.learn.ppo import PpoConfig
from softarm.training.task.environment import ACTIONS
from softarm.training.task.randomisation import Randomisation
from softarm.training.task.reach import ReachTask
from softarm.training.task.registry import plugin_of

Settings = dict[str, str | float | int | bool | list[float] | None]
DTYPES = {"float32": torch.float32, "bfloat16": torch.bfloat16}


@dataclass(frozen=True)
class TrainingConfig:
    """Settings of a run; equal settings on one machine give equal runs."""

    seed: int = 1
    robots: int = 2048
    physics_rate_hz: float = TRAINING_PHYSICS_RATE_HZ
    validate_every: int = 20  # iterations; a checkpoint is kept as often
    validation_trials: int = 1536
    averaging: float = 0.975  # share of the averaged weights that an iteration keeps, in the long run
    patience: int = 0  # validations without improvement after which a run stops; 0: no limit
    matrix_products: str = "auto"  # float32, bfloat16, or auto: bfloat16 if the processor has it
    device: str = "cpu"  # device of the robots and the network, cpu or cuda

    def products_on(self, device: torch.device) -> str:
        """Return the type of the matrix products on a device, float32 or bfloat16."""
        return quick_products(device) if self.matrix_products == "auto" else self.matrix_products


def quick_products(device: torch.device) -> str:
    """Return the type that `auto` selects: bfloat16 if the processor multiplies it in hardware, else float32."""
    return "bfloat16" if device.type == "cpu" and torch.cpu._is_avx512_bf16_supported() else "float32"


def recorded(
    task: ReachTask,
    config: TrainingConfig,
    ppo: PpoConfig,
    randomisation: Randomisation,
    shape: NetworkShape,
    model: Model,
    model_name: str,
) -> Settings:
    """Return all settings as `part.field` -> value."""
    settings = flat(task=task, run=config, ppo=ppo, randomise=randomisation, network=shape)
    if (plugin := plugin_of(task)) is not None:
        settings["task.plugin"] = plugin
    return settings | {"model.name": model_name, "model.sha256": model_file.fingerprint(model)}


def usual(task: ReachTask, inputs: int) -> Settings:
    """Return the default settings of a run of this kind of task."""
    shape = NetworkShape(inputs=inputs, actions=ACTIONS)
    return recorded(type(task)(), TrainingConfig(), PpoConfig(), Randomisation(), shape, Model(), "seed")


def flat(**parts: object) -> Settings:
    """Flatten dataclasses to a dictionary, `part.field` or `part.field.key`, with tuples as lists."""
    settings: Settings = {}
    for name, part in parts.items():
        for key, value in asdict(part).items():  # type: ignore[call-overload]
            fields = value if isinstance(value, dict) else {"": value}
            for under, single in fields.items():
                path = ".".join(filter(None, (name, key, under)))
                settings[path] = list(single) if isinstance(single, tuple) else single
    return settings
