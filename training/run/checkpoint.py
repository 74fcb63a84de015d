"""A training run on disk: everything needed to go on as if nothing had happened, or to export the policy."""

from pathlib import Path
from typing import Any

import torch

from softarm.common import files

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
