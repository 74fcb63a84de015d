"""Recordings as arguments: other files given in their place, and the rail limits that recordings show."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from softarm.cli.shared.console import FILE
from softarm.cli.shared.errors import fail

if TYPE_CHECKING:
    from softarm.daemon.limits.findings import RailFindings
    from softarm.schemas.verdict import Verdict


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


limits_option = click.option(
    "--limits",
    "limits_file",
    type=FILE,
    help="Write the rail limits that the recordings show to this file, a part of softarm.yaml.",
)


def write_limits(inputs: Sequence[Path], file: Path, verdict: "Verdict | None" = None) -> "RailFindings":
    """Write the rail limits that recordings show, and print those that become stricter.

    A rail delay that `verdict` names counts too.

    Raises:
        TrialError: A recording cannot be read.
        OSError: The file cannot be written.
    """
    from softarm.common import files
    from softarm.daemon.limits.findings import findings
    from softarm.diagnosis.data.read import rail_motions
    from softarm.evaluation.closing.diagnosed import with_diagnosed

    found = findings(rail_motions(inputs))
    if verdict is not None:
        found = with_diagnosed(found, verdict)
    files.write_text(file, found.patch())
    print_stricter(found)
    for row in found.rows:
        if row.bound is None and not row.is_too_lax:
            click.echo(f"limits.rail.{row.key}: {row.why}", err=True)
    return found


def print_stricter(found: "RailFindings") -> None:
    """Print a line for each configured limit that is laxer than the recordings show."""
    for row in found.rows:
        if row.is_too_lax:
            click.echo(f"limits.rail.{row.key} was {row.configured:g}: {row.why}; {row.advice}")
