"""What a measurement leaves: its figures as JSON, and under `about` which software gave them, where, when and how."""

import json
import shlex
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click

from softarm.common import files
from softarm.common.processes import cores
from softarm.common.revision import machine, revision

FILE = click.Path(path_type=Path, dir_okay=False)
json_option = click.option("--json", "json_file", type=FILE, help="Write the figures to this file.")


def write(file: Path, figures: Mapping[str, Any]) -> None:
    """Write figures, by name, and where they come from."""
    about = {
        "revision": revision(),
        "machine": {**machine(), "cpu": _cpu(), "cores": cores()},
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": _command(),
    }
    files.write_text(file, json.dumps({"about": about, **figures}, indent=1) + "\n")


def _cpu() -> str:
    """The processor's own name; empty where the system does not say."""
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")


def _command() -> str:
    """How this program was started: a module of the package by its name, anything else by its file."""
    spec = sys.modules["__main__"].__spec__
    started = ["python", sys.argv[0]] if spec is None else ["python", "-m", spec.name]
    return shlex.join([*started, *sys.argv[1:]])
