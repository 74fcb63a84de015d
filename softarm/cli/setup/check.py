"""`softarm check`: check a configuration and print its changed values, or check the stage.yaml of a rig."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.shared.console import FOLDER, print_json, print_option, print_table, waiting
from softarm.cli.shared.errors import fail, leaves
from softarm.common.processes import bar

if TYPE_CHECKING:
    from softarm.daemon.config.configuration import Loaded
    from softarm.diagnosis.data.trials import Trial


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--logs", "folder", type=FOLDER, help="Also compare the rail limits with these logs of the robot.")
@click.option("--data", type=FOLDER, help="Folder of the data files of a stage.yaml (default: its own folder).")
@click.option("--simulated", is_flag=True, help="Check for `softarm run --simulated`, which has no devices.")
@click.option("--all", "everything", is_flag=True, help="Also print every limit in force, with its source.")
@print_option
def check(file: Path, folder: Path | None, data: Path | None, simulated: bool, everything: bool, as_json: bool) -> None:
    """Check a configuration FILE; print the values that differ from the default.

    FILE may be the stage.yaml of another rig: every trial and column is read and checked as in `softarm diagnose`.

    Exit code 1, with every mistake and its line, if `softarm run` would not start with FILE now: an unknown key, a
    policy whose first step fails, a port in use, an unreadable token, or a folder that cannot be written. With --logs
    also if the robot had more latency, less braking or more acceleration than the rail limits allow for. Values for
    which the logs are too short are listed and are no mistake.

    \b
    Examples:
      softarm check softarm.yaml
      softarm check softarm.yaml --all
      softarm check softarm.yaml --logs logs
      softarm check softarm.yaml --json
      softarm check stage.yaml --data recordings
    """
    from softarm.common import realtime
    from softarm.daemon.config.configuration import changed, effective_limits
    from softarm.daemon.runtime import preflight
    from softarm.diagnosis.data.stage_file import is_stage

    if is_stage(file):
        if folder or simulated or everything or as_json:
            raise click.UsageError("--logs, --simulated, --all and --json are for a configuration; omit them here")
        check_stage(file, data)
        return
    if data is not None:
        raise click.UsageError("--data is for the data files of a stage.yaml: name one as FILE, or omit --data")
    leaves("nothing was changed")
    with waiting("checking the configuration and its policies"):
        found = preflight.look(file, wires=not simulated, thorough=True)
    problems, loaded = list(found.problems), found.loaded
    limits, differing = ([], []) if loaded is None else (effective_limits(loaded), changed(loaded))
    if loaded is not None and not (problems or as_json):
        if differing:
            print_table(("key", "value", "unit", "default", "from"), differing, f"{file}: changed values", width=140)
        if everything:
            columns = ("limit", "value", "unit", "allowed, or how it follows", "from")
            print_table(columns, limits, f"{file}: limits in force", width=140)
    if loaded is not None and folder is not None:
        problems += _too_lax(loaded, folder, quiet=as_json)
    if as_json:
        rows = [row._asdict() for row in limits]
        print_json({"file": str(file), "sound": not problems, "problems": problems, "limits": rows})
    if problems:
        fail("\n".join(problems))
    if (slow := realtime.refused(found.config.control.realtime_priority)) is not None:
        click.echo(f"warning: control.realtime_priority {found.config.control.realtime_priority}: {slow}", err=True)
    if not as_json:
        unchanged = "" if differing else "; all values are the defaults"
        click.echo(f"{file}: valid; starts with policy '{found.config.control.policy}'{unchanged}")


def _too_lax(loaded: "Loaded", folder: Path, quiet: bool) -> list[str]:
    """Return a sentence for each rail limit that is laxer than the logs show; print all limits unless `quiet`."""
    from softarm.daemon.limits.findings import findings
    from softarm.recordings import rail_motion

    with waiting(f"reading the logs in {folder}"):
        motions = [rail_motion.read(path) for path in sorted(folder.glob("*.mcap"))]
    if not motions:
        fail(f"{folder}: contains no log; name the recorder.directory, or another folder with .mcap files of the robot")
    found = findings(motions, loaded.config)
    rows = [(row.key, f"{row.configured:g}", row.measured, row.why) for row in found.rows]
    if not quiet:
        columns = ("limits.rail", "configured", "measured", "what the logs show")
        print_table(columns, rows, f"{folder}: the rail", width=140)
    for reason in found.measured.left_out:
        click.echo(f"left out: {reason}", err=True)
    return [
        f"{loaded.place(('limits', 'rail', row.key))}: limits.rail.{row.key}: is {row.configured:g}, laxer than the "
        f"robot in {folder}: {row.why}; {row.advice}"
        for row in found.rows
        if row.is_too_lax
    ]


WARNINGS_MAX = 20  # printed; the rest is counted


def check_stage(file: Path, data: Path | None) -> None:
    """Read every trial and column, build each stage's view, and print their contents. Exits with 1 for mistakes."""
    from softarm.diagnosis.data import tables
    from softarm.diagnosis.rigs.diagnose import merged

    trials = tables.read(file, data)
    columns = ("trial", "kind", "channel", "rows", "seconds", "column", "from", "to", "unit")
    rows = dict.fromkeys(row for trial in trials for row in _rows(trial))
    print_table(columns, [*rows], f"{file}: contents", width=140)
    stages = {trial.stage.name: trial.stage.kind for trial in trials if trial.stage is not None}
    problems, assumptions = _examined(trials, [*stages])
    warnings = merged([*(text for trial in trials for text in trial.warnings), *assumptions], [*stages])
    for text in warnings[:WARNINGS_MAX]:
        click.echo(f"warning: {text}", err=True)
    if len(warnings) > WARNINGS_MAX:
        click.echo(f"warning: and {len(warnings) - WARNINGS_MAX} more", err=True)
    if problems:
        fail("\n".join(problems))
    count = f"{len(trials)} trial{'s' if len(trials) > 1 else ''}"
    click.echo(f"{file}: valid; {count} of {', '.join(f'{name} ({kind})' for name, kind in stages.items())}")


def _examined(trials: "Sequence[Trial]", stages: Sequence[str]) -> tuple[list[str], list[str]]:
    """Build the view of each stage, and return the mistakes and the warnings about the description."""
    from softarm.diagnosis.data.trials import TrialError
    from softarm.diagnosis.rigs.stage import view_of

    problems, assumptions = list[str](), list[str]()
    with bar("checking", len(stages)) as progress:
        for name in stages:
            progress.advance(0, f"checking {name}")
            try:
                view, _ = view_of([trial for trial in trials if trial.stage is not None and trial.stage.name == name])
                assumptions += view.assumptions
            except TrialError as error:
                problems.append(str(error))
            progress.advance()
    return problems, assumptions


def _rows(trial: "Trial") -> list[tuple[str, ...]]:
    """Return a row for each column of a trial, in the unit of its stage file; joints of one model share theirs."""
    rows: list[tuple[str, ...]] = []
    joint = trial.stage.name if trial.stage is not None and trial.stage.kind == "mujoco" else None
    name = trial.name if joint is None else trial.name.removesuffix(f"/{joint}")
    for channel, series in trial.channels.items():
        seconds = f"{series.t_s[-1] - series.t_s[0]:.4g}"
        for column, values in series.columns.items():
            if joint is not None and channel == "measured" and column != joint:
                continue
            own = trial.stage.units[channel].get(column) if trial.stage is not None else None
            worth, unit = (own.factor, own.name) if own is not None else (1.0, "")
            low, high = f"{values.min() / worth:.4g}", f"{values.max() / worth:.4g}"
            rows.append((name, trial.kind, channel, str(len(series)), seconds, column, low, high, unit))
    return rows
