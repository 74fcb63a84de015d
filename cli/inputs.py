"""Files that stand where recordings belong, told by what they are."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from softarm.cli.errors import fail


def refuse_misplaced(paths: Iterable[Path]) -> None:
    """End the command with a sentence for a model, a verdict, a configuration or a policy among recordings."""
    for path in paths:
        if path.is_file() and (what := _misplaced(path)):
            fail(f"{path}: is {what}")


def _misplaced(path: Path) -> str:
    """What a file is, and where it belongs; empty where it may be a recording."""
    if path.suffix == ".onnx":
        return "a policy; name recordings, `softarm evaluate` flies policies"
    if path.suffix not in (".json", ".yaml", ".yml"):
        return ""
    keys = _keys(path)
    if {"verdict", "effects"} <= keys:
        return "a verdict; name recordings, `softarm excite --plan` flies what a verdict asks for"
    if path.suffix == ".json" or {"channels", "mechanisms", "trials"} & keys:
        return ""
    if {"arm", "cart", "effects"} & keys:
        return "a model of the robot; give it as --model, and name recordings"
    if {"limits", "drivers", "recorder", "control", "api"} & keys:
        return "a configuration of the daemon; name recordings, which lie in its recorder.directory"
    return ""


def _keys(path: Path) -> set[str]:
    from softarm.common import yaml_lines

    try:
        data: Any = json.loads(path.read_bytes()) if path.suffix == ".json" else yaml_lines.read(path, "").data
    except (OSError, ValueError, yaml_lines.FileError):
        return set()
    return set(data) if isinstance(data, dict) else set()
