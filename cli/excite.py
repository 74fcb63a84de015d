"""`softarm excite`: play an excitation through the daemon, on the robot or a simulated one, and record."""

import shlex
from pathlib import Path

import click

from softarm.cli.errors import fail
from softarm.cli.options import FILE, config_option, flown_model, model_option
from softarm.common.processes import bar


@click.command()
@click.argument("name", required=False)
@config_option
@click.option("--simulated", is_flag=True, help="A robot simulated in this process, as fast as it will go.")
@model_option
@click.option("--plan", type=FILE, help="Play what a diagnosis asks for next: its verdict.json.")
@click.option("--list", "show", is_flag=True, help="Show the excitations there are.")
def excite(
    name: str | None, config_file: Path | None, simulated: bool, model_file: Path | None, plan: Path | None, show: bool
) -> None:
    """Play the excitation NAME and record it: the arm is armed, moves, and is disarmed again.

    It is a policy like any other: safety filter, failsafe and recorder are the daemon's own, and while it plays
    the API answers, so `softarm stop` works. The cart is brought to the middle of the rail first.

    \b
    Examples:
      softarm excite --list
      softarm excite seed --config softarm.yaml        on the robot, about half a minute
      softarm excite rail-chirp --simulated            on a simulated one
      softarm excite --plan verdict.json --config softarm.yaml    the next experiment of `softarm diagnose`
    """
    from softarm.daemon.api.auth import AuthError
    from softarm.daemon.api.sockets import ApiError
    from softarm.daemon.config import configuration
    from softarm.daemon.logbook.recorder import RecorderError
    from softarm.daemon.shell.daemon import latch_of, real_devices
    from softarm.daemon.shell.play import length_s, play, play_simulated
    from softarm.daemon.stop.latch import LatchError
    from softarm.policies.base import PolicyError
    from softarm.schemas.config import Config
    from softarm.schemas.excitation import EXCITATIONS

    if show:
        for excitation in EXCITATIONS.values():
            click.echo(f"{excitation.name:20s} {excitation.duration_s:5.1f} s  {excitation.description}")
        return
    if plan is not None:
        if name is not None:
            raise click.UsageError("NAME or --plan, not both")
        name = _planned(plan)
    if name is None:
        raise click.UsageError("which excitation? `softarm excite --list` shows them")
    if config_file is None and not simulated:
        raise click.UsageError("which robot? --config FILE for real devices, or --simulated")
    if model_file is not None and not simulated:
        raise click.UsageError("--model is of the simulated robot: add --simulated")
    try:
        config = configuration.load(config_file) if config_file else Config()
        total_s = length_s(config, name)
        model = flown_model(model_file)
        with bar(f"playing {name}", total_s) as shown:
            if simulated:
                status, log = play_simulated(config, name, model, shown.show)
            else:
                status, log = play(config, name, real_devices(config), shown.show, latch_of(config))
    except (
        configuration.ConfigurationError,
        PolicyError,
        LatchError,
        RecorderError,
        ApiError,
        AuthError,
        RuntimeError,
    ) as error:
        fail(str(error))
    if status.state != "reached":
        fail(f"{name} was not played to its end: {status.state}, {status.reason}; what there is lies in {log}")
    click.echo(f"played {name}, {status.time_s:.1f} s; recorded {log}" if log else f"played {name}; nothing recorded")
    if log is not None and plan is not None:
        anew = plan.with_name(f"{plan.stem}-next.json")  # the old verdict stays until its recordings are told anew
        click.echo(f"next: softarm diagnose {shlex.quote(str(log))} --json {shlex.quote(str(anew))}")
        click.echo(f"(named before {log}, the recordings that {plan} came from count as well: together they decide)")
    elif log is not None:
        click.echo(f"next: softarm identify {shlex.quote(str(log))} --out model.yaml")


def _planned(plan: Path) -> str:
    """The excitation that a verdict asks for next. Ends the command with a sentence where there is none."""
    from pydantic import ValidationError

    from softarm.schemas.verdict import Verdict

    try:
        verdict = Verdict.model_validate_json(plan.read_bytes())
    except OSError as error:
        fail(f"{plan}: cannot be read ({error.strerror}); name a file that `softarm diagnose --json` wrote")
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(map(str, first["loc"]))
        fail(f"{plan}: {f'{where}: ' if where else ''}{first['msg']}; name a file that `softarm diagnose --json` wrote")
    if verdict.next_experiment is None:
        fail(f"{plan}: asks for no next experiment; name an excitation, `softarm excite --list` shows them")
    for effect, expected in verdict.next_experiment.expect.items():
        click.echo(f"if {effect}: {expected}")
    return verdict.next_experiment.excitation
