"""Checkpoints of a training run: files from which a run is resumed or a policy exported."""

from pathlib import Path
from typing import Any

import torch

from softarm.common import files
from softarm.common.plugins import PluginError
from softarm.training.learn.network import NetworkShape, PolicyNetwork
from softarm.training.task.reach import ReachTask
from softarm.training.task.registry import rebuilt

FORMAT = 1


class CheckpointError(Exception):
    """An unusable checkpoint or policy file; the text names the file, the problem and the remedy."""


def save(path: Path, content: dict[str, Any]) -> None:
    """Write a checkpoint atomically: an interruption leaves the old file or the new one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with files.replacing(path) as file:
        torch.save({"format": FORMAT, **content}, file)


def load(path: Path) -> dict[str, Any]:
    """Read tensors and plain values without executing anything in the file. Raises CheckpointError."""
    if not path.is_file():
        raise CheckpointError(f"{path}: no such checkpoint; `softarm train` writes latest.pt and best.pt to --out")
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # a damaged file makes torch raise many types
        reason = str(error).strip().partition("\n")[0]
        raise CheckpointError(f"{path}: not a checkpoint ({reason}); give a .pt file of `softarm train`") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise CheckpointError(f"{path}: not a checkpoint of format {FORMAT}; train again with this version")
    return content


def load_policy(source: Path) -> tuple[PolicyNetwork, dict[str, Any]]:
    """Return the network of a checkpoint and the whole content of the file. Raises CheckpointError."""
    saved = load(source)
    missing = {"settings", "task", "seed", "curve", "average"} - saved.keys()
    if missing:
        raise CheckpointError(f"{source}: {', '.join(sorted(missing))} missing; give a .pt file of `softarm train`")
    try:
        network = PolicyNetwork(NetworkShape(**saved.get("network", {})))
        network.load_state_dict(saved["average"])
    except Exception as error:  # invalid sizes, or weights of another network
        reason = " ".join(str(error).split())[:200]
        raise CheckpointError(f"{source}: holds no network ({reason}); give a .pt file of `softarm train`") from error
    return network, saved


def task_of(saved: dict[str, Any]) -> ReachTask:
    """Return the task of a checkpoint. Raises CheckpointError if the task's package is not installed."""
    try:
        return rebuilt(saved.get("kind", "reach"), saved["task"])
    except PluginError as error:
        raise CheckpointError(f"{error}: install the package that it was trained with") from error
