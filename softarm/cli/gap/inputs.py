"""Recognition of files that are given in place of recordings."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from softarm.cli.shared.errors import fail


def refuse_misplaced(paths: Iterable[Path]) -> None:
    """End the command with a sentence if a model, verdict, configuration or policy is among the recordings."""
    for path in paths:
        if path.is_file() and (description := _misplaced(path)):
            fail(f"{path}: is {description}")


def _misplaced(path: Path) -> str:
    """Return what a file is and where it belongs; empty if it may be a recording."""
    if path.suffix == ".onnx":
        return "a policy; name recordings here, and fly policies with `softarm evaluate`"
    if path.suffix not in (".json", ".yaml", ".yml"):
        return ""
    keys = _keys(path)
    if {"verdict", "effects"} <= keys:
        return "a verdict; name recordings here, and play its next experiment with `softarm excite --plan`"
    if path.suffix == ".json" or {"channels", "mechanisms", "trials"} & keys:
        return ""
    if {"arm", "cart", "effects"} & keys:
        return "a model of the robot; give it as --model, and name recordings"
    if {"limits", "drivers", "recorder", "control", "api"} & keys:
        return "a configuration of the daemon; name recordings, which are in its recorder.directory"
    return ""


def _keys(path: Path) -> set[str]:
    from softarm.common import yaml_lines

    try:
        data: Any = json.loads(path.read_bytes()) if path.suffix == ".json" else yaml_lines.read(path, "").data
    except (OSError, ValueError, yaml_lines.FileError):
        return set()
    return set(data) if isinstance(data, dict) else set()
