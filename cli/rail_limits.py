"""The limits that recordings show of the rail, written by the verbs that read recordings."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.options import FILE

if TYPE_CHECKING:
    from softarm.daemon.limits.findings import RailFindings
    from softarm.schemas.verdict import Verdict

limits_option = click.option(
    "--limits",
    "limits_file",
    type=FILE,
    help="Write the rail's limits as the recordings show them to this file, a piece of softarm.yaml.",
)


def write_limits(inputs: Sequence[Path], file: Path, verdict: "Verdict | None" = None) -> "RailFindings":
    """Write limits-patch.yaml and say what becomes stricter; by a verdict's late rail too, as `close-gap` does.

    Raises TrialError, OSError.
    """
    from softarm.common import files
    from softarm.daemon.limits.findings import findings
    from softarm.diagnosis.data.read import rail_motions
    from softarm.flights.closing.diagnosed import with_diagnosed

    found = findings(rail_motions(inputs))
    if verdict is not None:
        found = with_diagnosed(found, verdict)
    files.write_text(file, found.patch())
    tell_stricter(found)
    for row in found.rows:
        if row.bound is None and not row.milder:
            click.echo(f"limits.rail.{row.key}: {row.why}", err=True)
    return found


def tell_stricter(found: "RailFindings") -> None:
    """A line for each limit that is milder than the robot was."""
    for row in found.rows:
        if row.milder:
            click.echo(f"limits.rail.{row.key} was {row.configured:g}: {row.why}; {row.advice}")
