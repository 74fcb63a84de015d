"""A training run on disk: everything needed to go on as if nothing had happened, or to export the policy."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from softarm.common import files
from softarm.common.plugins import PluginError
from softarm.training.learn.network import NetworkShape, PolicyNetwork
from softarm.training.record.curve import Iteration
from softarm.training.run.settings import usual
from softarm.training.task.reach import ReachTask
from softarm.training.task.registry import plugin_of, rebuilt

if TYPE_CHECKING:
    from softarm.training.run.session import Session

FORMAT = 1


class CheckpointError(Exception):
    """A file that cannot be used; the text names it, what is wrong and the next step."""


def save(path: Path, content: dict[str, Any]) -> None:
    """Write in one piece, so that a kill leaves the file before or the file after."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with files.replacing(path) as file:
        torch.save({"format": FORMAT, **content}, file)


def load(path: Path) -> dict[str, Any]:
    """Read tensors and plain values; nothing in the file is executed. Raises CheckpointError."""
    if not path.is_file():
        raise CheckpointError(f"{path}: no such checkpoint; `softarm train` writes latest.pt and best.pt to --out")
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # whatever a damaged file makes torch raise
        reason = str(error).strip().partition("\n")[0]
        raise CheckpointError(f"{path}: not a checkpoint ({reason}); give a .pt file of `softarm train`") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise CheckpointError(f"{path}: not a checkpoint of format {FORMAT}; train again with this version")
    return content


def policy_of(session: "Session") -> dict[str, Any]:
    """What of a session makes its policy: the averaged weights and how they came to be."""
    return {
        "settings": session.settings,
        "average": session.average.state_dict(),
        "network": asdict(session.network.shape),
        "kind": session.task.kind,
        "task": asdict(session.task) | ({} if (plugin := plugin_of(session.task)) is None else {"plugin": plugin}),
        "seed": session.config.seed,
        "frames": session.frames,
        "seconds": session.seconds,
        "best": session.best,
        "curve": [tuple(row) for row in session.curve],
    }


def all_of(session: "Session") -> dict[str, Any]:
    """What a session goes on from: its policy, and where the learner stands."""
    return policy_of(session) | {"learner": session.learner.snapshot()}


def restore(session: "Session", saved: dict[str, Any]) -> None:
    """Put a new session where `all_of` left one. Raises CheckpointError when that had other settings."""
    # Older ones knew no other model, network or robots that differ.
    settings = usual(session.task, session.network.shape.inputs) | saved["settings"]
    for key, value in session.settings.items():
        if settings.get(key) != value:
            raise CheckpointError(
                f"{session.out / 'latest.pt'}: was trained with {key} = {settings.get(key)}, not {value}; "
                "resume with the same settings or give another --out"
            )
    session.learner.restore(saved["learner"])
    session.average.load_state_dict(saved["average"])
    session.frames, session.seconds = saved["frames"], saved["seconds"]
    session.curve = [Iteration(*row) for row in saved["curve"]]


def load_policy(source: Path) -> tuple[PolicyNetwork, dict[str, Any]]:
    """Return the network of a session's checkpoint, and all else that is in the file. Raises CheckpointError."""
    saved = load(source)
    missing = {"settings", "task", "seed", "curve", "average"} - saved.keys()
    if missing:
        raise CheckpointError(f"{source}: {', '.join(sorted(missing))} missing; give a .pt file of `softarm train`")
    try:
        network = PolicyNetwork(NetworkShape(**saved.get("network", {})))
        network.load_state_dict(saved["average"])
    except Exception as error:  # of sizes that are none, or weights of another network
        reason = " ".join(str(error).split())[:200]
        raise CheckpointError(f"{source}: holds no network ({reason}); give a .pt file of `softarm train`") from error
    return network, saved


def task_of(saved: dict[str, Any]) -> ReachTask:
    """The task of a checkpoint. Raises CheckpointError when it is another package's, which is not installed."""
    try:
        return rebuilt(saved.get("kind", "reach"), saved["task"])
    except PluginError as error:
        raise CheckpointError(f"{error}: install the package that it was trained with") from error
