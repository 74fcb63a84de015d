"""`softarm soak`: does anything grow, and does anything happen, when it flies for hours?"""

import shlex
import sys
import tempfile
from pathlib import Path

import click

from softarm.cli.completion import policies
from softarm.cli.errors import fail
from softarm.cli.interrupt import leaves
from softarm.cli.options import FILE, check_places, json_option, write, write_json


@click.command()
@click.option("--hours", default=1.0, show_default=True, type=click.FloatRange(0), help="In real time; 0 for none.")
@click.option(
    "--lockstep-days",
    default=0.0,
    show_default=True,
    type=click.FloatRange(0),
    help="Of simulated time, meanwhile, in a process of their own.",
)
@click.option("--seed", default=0, show_default=True, help="Of goals, faults and bad clients.")
@click.option("--policy", default="reach", show_default=True, shell_complete=policies, help="Who flies in lockstep.")
@json_option
@click.option("--report", type=FILE, help="Write the curves as one HTML file.")
@click.option("--logs", type=click.Path(path_type=Path, file_okay=False), help="Keep the recordings in this folder.")
def soak(
    hours: float,
    lockstep_days: float,
    seed: int,
    policy: str,
    json_file: Path | None,
    report: Path | None,
    logs: Path | None,
) -> None:
    """Fly for hours, and say whether memory, descriptors, threads, logs, lateness and load stay as they are.

    In real time daemon and twin are processes of their own. The twin breaks now and then, clients of the API behave
    badly, and a script arms, gives goals, stops, acknowledges and changes policies. In lockstep the daemon's tick flies
    goals as fast as one core goes. Ends with 1 when something grows, was not watched for long enough to tell, or was
    not expected: a stop that no fault explains, an error, an answer that nobody may get.

    \b
    Examples:
      softarm soak --hours 1 --lockstep-days 3 --report soak.html --json soak.json
      softarm soak --hours 0 --lockstep-days 0.1
    """
    from softarm.common.processes import bar
    from softarm.flights.soak import both, page
    from softarm.flights.software_in_the_loop import SoftwareInTheLoopError
    from softarm.policies.base import PolicyError

    if not hours and not lockstep_days:
        raise click.UsageError("nothing to do: give --hours, --lockstep-days, or both")
    check_places(json_file, report)
    kept_there = "" if logs is None else f"; the recordings lie in {logs}"
    leaves(f"twin and daemon have ended, nothing is told{kept_there}")
    with tempfile.TemporaryDirectory(prefix="softarm-soak-") as folder:
        kept = Path(folder) if logs is None else logs
        kept.mkdir(parents=True, exist_ok=True)
        if any(kept.iterdir()):
            fail(f"--logs {kept}: is not empty; the size of this folder is watched, name a new one")
        try:
            with bar("soaking") as shown:
                real, stepped = both.soak(hours, lockstep_days, seed, policy, kept, shown.tell)
        except (SoftwareInTheLoopError, PolicyError) as error:
            fail(str(error))
    write_json(json_file, page.figures(real, stepped))
    if report is not None:
        write(report, page.html(real, stepped, shlex.join(["softarm", *sys.argv[1:]])))
    problems = page.problems(real, stepped)
    if problems:
        fail("\n".join(problems))
    click.echo("flat, and nothing happened that should not")
