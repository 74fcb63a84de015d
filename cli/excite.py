"""`softarm excite`: play an excitation through the daemon, on the robot or a simulated one, and record."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.completion import excitations
from softarm.cli.errors import fail
from softarm.cli.interrupt import leaves
from softarm.cli.options import FILE, FOLDER, config_option, flown_model, model_option
from softarm.cli.played import planned, tell_next
from softarm.cli.prepared import prepared
from softarm.cli.robots import independent_body
from softarm.common.processes import bar

if TYPE_CHECKING:
    from softarm.schemas.goals import GoalStatus


@click.command()
@click.argument("names", nargs=-1, metavar="[NAME]...", shell_complete=excitations)
@config_option
@click.option("--simulated", is_flag=True, help="A robot simulated in this process, as fast as it will go.")
@click.option("--reality", is_flag=True, help="The independent robot in MuJoCo instead (docs/reality.md).")
@click.option("--fault", "faults", multiple=True, metavar="GROUP.QUANTITY=VALUE", help="Of --reality; again for more.")
@model_option
@click.option("--plan", type=FILE, help="Play what a diagnosis asks for next: its verdict.json.")
@click.option("--logs", type=FOLDER, help="Where recordings go (default: the configuration's recorder.directory).")
@click.option("--list", "show", is_flag=True, help="Show the excitations there are.")
def excite(
    names: tuple[str, ...],
    config_file: Path | None,
    simulated: bool,
    reality: bool,
    faults: tuple[str, ...],
    model_file: Path | None,
    plan: Path | None,
    logs: Path | None,
    show: bool,
) -> None:
    """Play the excitations NAME and record each: the arm is armed, moves, and is disarmed again.

    Each is a policy like any other: safety filter, failsafe and recorder are the daemon's own, and while it plays
    the API answers, so `softarm stop` works. The cart is brought to the middle of the rail first.

    \b
    Examples:
      softarm excite --list
      softarm excite seed --config softarm.yaml        on the robot, about half a minute
      softarm excite seed rail-steps both --config softarm.yaml --logs campaign
      softarm excite rail-chirp --simulated            on a simulated one
      softarm excite seed --reality --fault arm.payload_kg=0.03     on one that shares no line with the simulator
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

    wrong = (configuration.ConfigurationError, PolicyError, LatchError, RecorderError, ApiError, AuthError)
    if show:
        for excitation in EXCITATIONS.values():
            click.echo(f"{excitation.name:20s} {excitation.duration_s:5.1f} s  {excitation.description}")
        return
    if plan is not None:
        if names:
            raise click.UsageError("NAME or --plan, not both")
        names = (planned(plan),)
    if not names:
        raise click.UsageError("which excitation? `softarm excite --list` shows them")
    if config_file is None and not (simulated or reality):
        raise click.UsageError("which robot? --config FILE for real devices, --simulated, or --reality")
    if model_file is not None and not (simulated or reality):
        raise click.UsageError("--model is of the simulated robot: add --simulated")
    if faults and not reality:
        raise click.UsageError("--fault is for the independent robot: add --reality")
    drive = "" if simulated or reality else "the cart was braked, the muscle vented, the drive is off; "
    leaves(f"{drive}what was recorded stays, the excitation in hand is not whole")
    try:
        if simulated or reality:
            config = configuration.load(config_file) if config_file else Config()
        else:
            config = prepared(config_file, wires=True)
        if logs is not None:
            recorder = config.recorder.model_copy(update={"directory": logs})
            config = config.model_copy(update={"recorder": recorder})
        lengths_s = [length_s(config, name) for name in names]  # every name is looked up before the first is played
        model = flown_model(model_file)
        recorded = []
        for name, total_s in zip(names, lengths_s, strict=True):
            body = independent_body(model, faults) if reality else None
            with bar(f"playing {name}", total_s) as shown:
                if simulated or reality:
                    status, log = play_simulated(config, name, model, shown.show, body)
                else:
                    status, log = play(config, name, real_devices(config), shown.show, latch_of(config))
            _tell(name, status, log)
            recorded.append(log)
    except (*wrong, RuntimeError) as error:
        fail(str(error))
    tell_next([log for log in recorded if log is not None], plan)


def _tell(name: str, status: "GoalStatus", log: Path | None) -> None:
    """How one went. Ends the command with a sentence when it was not played to its end."""
    if status.state != "reached":
        fail(f"{name} was not played to its end: {status.state}, {status.reason}; what there is lies in {log}")
    click.echo(f"played {name}, {status.time_s:.1f} s; recorded {log}" if log else f"played {name}; nothing recorded")
