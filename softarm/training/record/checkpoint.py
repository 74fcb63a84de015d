"""Settings of a training run, and checkpoints: files from which a run is resumed or a policy exported."""

from collections.abc import Mapping, Set
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import torch
from pydantic import Field

from softarm.common import files
from softarm.common.plugins import PluginError
from softarm.schemas.base import Strict
from softarm.schemas.model import Model
from softarm.schemas.robot import TRAINING_PHYSICS_RATE_HZ
from softarm.simulator import model_file
from softarm.simulator.pack import RATE_MIN_HZ
from softarm.training.learn.network import NetworkShape, PolicyNetwork
from softarm.training.learn.ppo import PpoConfig
from softarm.training.task import registry
from softarm.training.task.environment import ACTIONS, Randomisation
from softarm.training.task.reach import ReachTask

Settings = dict[str, str | float | int | bool | list[float] | None]
DTYPES = {"float32": torch.float32, "bfloat16": torch.bfloat16}
Products = Literal["float32", "bfloat16"]
SEED_MAX = 2**32 - 1


@dataclass(frozen=True)
class TrainingConfig:
    """Settings of a run; equal settings on one machine give equal runs."""

    __pydantic_config__ = Strict.model_config

    seed: Annotated[int, Field(ge=0, le=SEED_MAX)] = 1
    robots: Annotated[int, Field(ge=1)] = 2048
    physics_rate_hz: Annotated[float, Field(ge=RATE_MIN_HZ)] = TRAINING_PHYSICS_RATE_HZ
    validate_every: Annotated[int, Field(ge=1)] = 20  # iterations; a checkpoint is kept as often
    validation_trials: Annotated[int, Field(ge=1)] = 1536
    # Share of the averaged weights that an iteration keeps, in the long run.
    averaging: Annotated[float, Field(ge=0, le=1)] = 0.975
    # Validations without improvement after which a run stops; 0: no limit.
    patience: Annotated[int, Field(ge=0)] = 0
    matrix_products: Literal["auto", Products] = "auto"  # auto: bfloat16 if the processor has it
    device: Literal["cpu", "cuda"] = "cpu"  # device of the robots and the network

    def products_on(self, device: torch.device) -> Products:
        """Return the type of the matrix products on a device, float32 or bfloat16."""
        return quick_products(device) if self.matrix_products == "auto" else self.matrix_products


def quick_products(device: torch.device) -> Products:
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
    if (plugin := registry.plugin_of(task)) is not None:
        settings["task.plugin"] = plugin
    return settings | {"model.name": model_name, "model.sha256": model_file.fingerprint(model)}


def usual(task: ReachTask, inputs: int) -> Settings:
    """Return the default settings of a run of this kind of task."""
    shape, plugin = NetworkShape(inputs=inputs, actions=ACTIONS), registry.plugin_of(task)
    # A plug-in may publish an object whose class has fields without a default.
    default = type(task)() if plugin is None else registry.load(plugin)
    return recorded(default, TrainingConfig(), PpoConfig(), Randomisation(), shape, Model(), "seed")


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


FORMAT = 1


class CheckpointError(Exception):
    """An unusable checkpoint or policy file; the text names the file, the problem and the remedy."""


def save(path: Path, content: dict[str, Any]) -> None:
    """Write a checkpoint atomically: an interruption leaves the old file or the new one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with files.replacing(path) as file:
        torch.save({"format": FORMAT, **content}, file)


def load(path: Path, needed: Set[str] = frozenset()) -> dict[str, Any]:
    """Read tensors and plain values without executing anything in the file.

    Raises CheckpointError, also if the file lacks a needed key.
    """
    if not path.is_file():
        raise CheckpointError(f"{path}: no such checkpoint; `softarm train` writes latest.pt and best.pt to --out")
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # a damaged file makes torch raise many types
        reason = str(error).strip().partition("\n")[0]
        raise CheckpointError(f"{path}: not a checkpoint ({reason}); give a .pt file of `softarm train`") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise CheckpointError(f"{path}: not a checkpoint of format {FORMAT}; train again with this version")
    if missing := needed - content.keys():
        raise CheckpointError(
            f"{path}: {', '.join(sorted(missing))} missing; give a .pt file of `softarm train`: latest.pt to resume, "
            "latest.pt or best.pt for `softarm dev export`"
        )
    return content


def load_policy(source: Path) -> tuple[PolicyNetwork, dict[str, Any]]:
    """Return the network of a checkpoint and the whole content of the file. Raises CheckpointError."""
    saved = load(source, {"settings", "task", "seed", "curve", "average"})
    try:
        network = PolicyNetwork(NetworkShape(**saved.get("network", {})))
        network.load_state_dict(saved["average"])
    except Exception as error:  # invalid sizes, or weights of another network
        reason = " ".join(str(error).split())[:200]
        raise CheckpointError(f"{source}: holds no network ({reason}); give a .pt file of `softarm train`") from error
    return network, saved


def task_of(source: Path, saved: Mapping[str, Any]) -> ReachTask:
    """Return the task that a file records. Raises CheckpointError if the installed packages lack it or its fields."""
    try:
        return registry.rebuilt(saved.get("kind", "reach"), saved["task"])
    except (PluginError, TypeError, ValueError) as error:
        raise CheckpointError(
            f"{source}: its task cannot be built ({error}); install the package and version that trained it"
        ) from error
