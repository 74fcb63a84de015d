"""`softarm check`: is the configuration sound, what does it hold the arm to, and was the robot worse than it says.

Or a rig's stage.yaml: would `softarm diagnose` take it.
"""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.check_stage import check_stage
from softarm.cli.errors import fail
from softarm.cli.options import FOLDER
from softarm.cli.printing import print_table

if TYPE_CHECKING:
    from softarm.daemon.config.configuration import Loaded


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--logs", "folder", type=FOLDER, help="Logs of the robot: is FILE milder than it was?")
@click.option("--data", type=FOLDER, help="Where the files of a stage.yaml lie (default: beside it).")
def check(file: Path, folder: Path | None, data: Path | None) -> None:
    """Check a configuration FILE; print the limits in force and where each comes from.

    FILE may be the stage.yaml of another rig: every trial and column is read as `softarm diagnose` would, before any
    fit.

    Exit code 1, with every mistake and its line, when the daemon would refuse the file; with --logs also when the robot
    was later, slower to brake or quicker to speed up than the rail's limits say. What too few logs show is said, and
    is no mistake.

    \b
    Examples:
      softarm check softarm.yaml
      softarm check softarm.yaml --logs logs
      softarm check stage.yaml --data recordings
    """
    from softarm.daemon.api.auth import AuthError, load_tokens
    from softarm.daemon.config.configuration import ConfigurationError, effective_limits, read
    from softarm.daemon.config.policies import policy_problems
    from softarm.diagnosis.data.stage_file import is_stage

    if is_stage(file):
        check_stage(file, data)
        return
    if data is not None:
        raise click.UsageError("--data is where the files of a stage.yaml lie: name one as FILE, or leave --data out")
    try:
        loaded = read(file)
    except ConfigurationError as error:
        fail(str(error))
    columns = ("limit", "value", "unit", "allowed, or how it follows", "from")
    print_table(columns, effective_limits(loaded), f"{file}: limits in force", width=140)
    problems = list(policy_problems(loaded))
    try:
        load_tokens(loaded.config.api)
    except AuthError as error:
        problems.append(f"{loaded.place(('api', error.key))}: {error}")
    if folder is not None:
        problems += _milder(loaded, folder)
    if problems:
        fail("\n".join(problems))
    click.echo(f"{file}: sound; starts with policy '{loaded.config.control.policy}'")


def _milder(loaded: "Loaded", folder: Path) -> list[str]:
    """Prints what the logs of a folder show of the rail; a sentence for each limit that is milder."""
    from softarm.daemon.limits.findings import findings
    from softarm.recordings import rail_motion
    from softarm.recordings.mcap_file import LogError

    try:
        motions = [rail_motion.read(path) for path in sorted(folder.glob("*.mcap"))]
    except LogError as error:
        fail(str(error))
    if not motions:
        fail(f"{folder}: holds no log; name the folder of recorder.directory, or any with .mcap files of the robot")
    found = findings(motions, loaded.config)
    rows = [(row.key, f"{row.configured:g}", row.measured, row.why) for row in found.rows]
    print_table(("limits.rail", "configured", "measured", "what the logs show"), rows, f"{folder}: the rail", width=140)
    for reason in found.measured.left_out:
        click.echo(f"left out: {reason}", err=True)
    return [
        f"{loaded.place(('limits', 'rail', row.key))}: limits.rail.{row.key}: is {row.configured:g}, milder than the "
        f"robot in {folder}: {row.why}; {row.advice}"
        for row in found.rows
        if row.milder
    ]
