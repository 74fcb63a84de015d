"""`softarm check`: is the configuration sound, what does it hold the arm to, and was the robot worse than it says.

Or a rig's stage.yaml: would `softarm diagnose` take it.
"""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.check_stage import check_stage
from softarm.cli.errors import fail
from softarm.cli.interrupt import leaves
from softarm.cli.options import FOLDER
from softarm.cli.printing import print_json, print_option, print_table, waiting

if TYPE_CHECKING:
    from softarm.daemon.config.configuration import Loaded


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--logs", "folder", type=FOLDER, help="Logs of the robot: is FILE milder than it was?")
@click.option("--data", type=FOLDER, help="Where the files of a stage.yaml lie (default: beside it).")
@click.option("--simulated", is_flag=True, help="For `softarm run --simulated`: no robot whose stop has to be kept.")
@print_option
def check(file: Path, folder: Path | None, data: Path | None, simulated: bool, as_json: bool) -> None:
    """Check a configuration FILE; print the limits in force and where each comes from.

    FILE may be the stage.yaml of another rig: every trial and column is read as `softarm diagnose` would, before any
    fit.

    Exit code 1, with every mistake and its line, when `softarm run` would not start with it here and now: a wrong key,
    a policy that cannot do its first step, a port that is taken, a token or a folder that is not to be had. With --logs
    also when the robot was later, slower to brake or quicker to speed up than the rail's limits say. What too few logs
    show is said, and is no mistake.

    \b
    Examples:
      softarm check softarm.yaml
      softarm check softarm.yaml --logs logs
      softarm check softarm.yaml --json
      softarm check stage.yaml --data recordings
    """
    from softarm.daemon.config.configuration import effective_limits
    from softarm.daemon.shell import preflight, realtime
    from softarm.diagnosis.data.stage_file import is_stage

    if is_stage(file):
        check_stage(file, data)
        return
    if data is not None:
        raise click.UsageError("--data is where the files of a stage.yaml lie: name one as FILE, or leave --data out")
    leaves("nothing was changed")
    with waiting("trying out what the file asks for"):
        found = preflight.look(file, wires=not simulated, thorough=True)
    problems, loaded = list(found.problems), found.loaded
    limits = [] if loaded is None else effective_limits(loaded)
    if loaded is not None and not (problems or as_json):
        columns = ("limit", "value", "unit", "allowed, or how it follows", "from")
        print_table(columns, limits, f"{file}: limits in force", width=140)
    if loaded is not None and folder is not None:
        problems += _milder(loaded, folder, told=not as_json)
    if as_json:
        rows = [row._asdict() for row in limits]
        print_json({"file": str(file), "sound": not problems, "problems": problems, "limits": rows})
    if problems:
        fail("\n".join(problems))
    if (slow := realtime.refused(found.config.control.realtime_priority)) is not None:
        click.echo(f"warning: control.realtime_priority {found.config.control.realtime_priority}: {slow}", err=True)
    if not as_json:
        click.echo(f"{file}: sound; starts with policy '{found.config.control.policy}'")


def _milder(loaded: "Loaded", folder: Path, told: bool) -> list[str]:
    """A sentence for each limit that is milder than the logs of a folder show the rail; told: prints what they show."""
    from softarm.daemon.limits.findings import findings
    from softarm.recordings import rail_motion
    from softarm.recordings.mcap_file import LogError

    try:
        with waiting(f"reading the logs in {folder}"):
            motions = [rail_motion.read(path) for path in sorted(folder.glob("*.mcap"))]
    except LogError as error:
        fail(str(error))
    if not motions:
        fail(f"{folder}: holds no log; name the folder of recorder.directory, or any with .mcap files of the robot")
    found = findings(motions, loaded.config)
    rows = [(row.key, f"{row.configured:g}", row.measured, row.why) for row in found.rows]
    if told:
        columns = ("limits.rail", "configured", "measured", "what the logs show")
        print_table(columns, rows, f"{folder}: the rail", width=140)
    for reason in found.measured.left_out:
        click.echo(f"left out: {reason}", err=True)
    return [
        f"{loaded.place(('limits', 'rail', row.key))}: limits.rail.{row.key}: is {row.configured:g}, milder than the "
        f"robot in {folder}: {row.why}; {row.advice}"
        for row in found.rows
        if row.milder
    ]
