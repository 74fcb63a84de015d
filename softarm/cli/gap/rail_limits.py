"""The --limits option: rail limits measured from recordings."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.shared.options import FILE

if TYPE_CHECKING:
    from softarm.daemon.limits.findings import RailFindings
    from softarm.schemas.verdict import Verdict

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
