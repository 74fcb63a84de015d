"""Command line of the soak test."""

import tempfile
from functools import partial
from pathlib import Path

import click

from softarm.cli.shared.completion import policies
from softarm.cli.shared.console import FOLDER, Number, check_places, json_option, write_json
from softarm.cli.shared.errors import failing
from softarm.common.processes import bar
from softarm.evaluation.software_in_the_loop import SoftwareInTheLoopError
from softarm.policies.base import PolicyError
from validation.soak import lockstep, page, realtime


@click.command()
@click.option("--hours", default=1.0, show_default=True, type=Number(0), help="Real time; 0 for none.")
@click.option("--lockstep-days", default=0.0, show_default=True, type=Number(0), help="Simulated time.")
@click.option("--seed", default=0, show_default=True, help="Seed of goals, faults and misbehaving clients.")
@click.option("--policy", default="reach", show_default=True, shell_complete=policies, help="Policy in lockstep.")
@json_option
@click.option("--allow-undecided", is_flag=True, help="Exit with 0 although the run was too short to decide on growth.")
@click.option("--logs", type=FOLDER, help="Keep the recordings in this folder.")
def main(
    hours: float,
    lockstep_days: float,
    seed: int,
    policy: str,
    json_file: Path | None,
    allow_undecided: bool,
    logs: Path | None,
) -> None:
    """Fly for hours, and report whether memory, descriptors, threads, logs, lateness or load grow.

    In real time, daemon and twin run as separate processes. The twin injects faults, clients of the API misbehave, and
    a script arms, sets goals, stops, acknowledges and changes policies. In lockstep, the control loop flies goals as
    fast as one core allows. Exit code 1 if something grows, if the run was too short to decide, or after an unexpected
    event: a stop without a fault, an error, or an answer that the client must not get.

    \b
    Examples:
      python -m validation.soak --hours 1 --lockstep-days 3 --json soak.json
      python -m validation.soak --hours 0 --lockstep-days 0.1
    """
    if not hours and not lockstep_days:
        raise click.UsageError("nothing to do: give --hours, --lockstep-days, or both")
    check_places(json_file)
    real, stepped = None, None
    with tempfile.TemporaryDirectory(prefix="softarm-soak-") as folder:
        kept = Path(folder) if logs is None else logs
        with failing(OSError):
            kept.mkdir(parents=True, exist_ok=True)
        if any(kept.iterdir()):
            raise click.ClickException(f"--logs {kept}: is not empty, and its size is measured; name a new folder")
        with failing(SoftwareInTheLoopError, PolicyError), bar("soaking") as shown:
            if lockstep_days:
                stepped = lockstep.soak(lockstep_days, seed, policy, partial(shown.report, "in lockstep"))
            if hours:
                real = realtime.soak(hours, seed, kept, shown.report)
    write_json(json_file, page.figures(real, stepped))
    if problems := page.problems(real, stepped, with_undecided=not allow_undecided):
        raise click.ClickException("\n".join(problems))
    click.echo("no growth found and no unexpected event")


if __name__ == "__main__":
    main()
