"""`softarm run`: the daemon, on the robot's wires or on a robot simulated in this process."""

import signal
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.errors import fail
from softarm.cli.interrupt import leaves, left_now
from softarm.cli.options import config_option, flown_model, model_option
from softarm.cli.prepared import prepared
from softarm.cli.words import Formatter, in_commands

if TYPE_CHECKING:
    from softarm.daemon.foxglove.guest import FoxgloveGuest
    from softarm.daemon.shell.daemon import Daemon
    from softarm.schemas.config import Config


@click.command()
@config_option
@click.option("--simulated", is_flag=True, help="Move a robot simulated in this process, no real devices.")
@model_option
@click.option(
    "--foxglove",
    metavar="[[HOST:]PORT]",
    is_flag=False,
    flag_value="8765",
    help="Serve live to Foxglove, to look and nothing else; on this computer alone unless HOST says otherwise.  [8765]",
)
def run(config_file: Path | None, simulated: bool, model_file: Path | None, foxglove: str | None) -> None:
    """Run the control daemon until Ctrl-C or SIGTERM.

    It starts disarmed. Ask it for things over REST, or with `softarm arm`, `goal`, `status` and `stop`.

    \b
    Examples:
      softarm run --config softarm.yaml        on the robot
      softarm run --simulated                  nothing but this computer
      softarm run --simulated --foxglove       and live in Foxglove, at ws://127.0.0.1:8765
      softarm run --config twin.yaml           on the twin that `softarm twin --config twin.yaml` started
    """
    import logging

    from softarm.common.plugins import PluginError
    from softarm.daemon.api.auth import AuthError
    from softarm.daemon.api.sockets import ApiError
    from softarm.daemon.foxglove.guest import FoxgloveError
    from softarm.daemon.logbook.recorder import RecorderError
    from softarm.daemon.shell import daemon
    from softarm.daemon.stop.latch import LatchError

    if config_file is None and not simulated:
        raise click.UsageError(
            "which robot? --config FILE for real devices (`softarm config new` writes one), or --simulated"
        )
    output = logging.StreamHandler()
    output.setFormatter(Formatter("%(levelname)s %(name)s: %(message)s"))
    logging.basicConfig(level=logging.INFO, handlers=[output])
    logging.getLogger("uvicorn").setLevel(logging.WARNING)
    leaves("nothing had begun")
    try:
        config = prepared(config_file, wires=not simulated)
        guest = None if foxglove is None else _guest(config, foxglove)
        if simulated:
            ended = daemon.run(config, daemon.simulated_devices(flown_model(model_file)), announce, foxglove=guest)
        else:
            ended = daemon.run(config, daemon.real_devices(config), announce, daemon.latch_of(config), guest)
    except (PluginError, LatchError, RecorderError, FoxgloveError, ApiError, AuthError) as error:
        fail(str(error))
    if ended == signal.SIGINT:
        raise KeyboardInterrupt
    click.echo(f"ended: {left_now()}", err=True)


def _left(running: "Daemon") -> str:
    """Of a daemon that has ended."""
    last = running.loop.snapshot
    latched = last is not None and last.estop != "clear" and running.latch is not None
    stop = "; the emergency stop stays latched until `softarm acknowledge` after the next start" if latched else ""
    log = running.recorder.path
    return f"the drive is off, the muscle vented{stop}" + (f"; {log} is closed" if log else "")


def _guest(config: "Config", address: str) -> "FoxgloveGuest":
    """Who serves at [HOST:]PORT."""
    from softarm.daemon.foxglove.guest import FoxgloveGuest

    host, _, port = address.rpartition(":")
    if not (port.isdecimal() and int(port) < 65536):
        raise click.UsageError(f"--foxglove {address}: allowed PORT or HOST:PORT, PORT 0 to 65535 (0: any)")
    return FoxgloveGuest(config, host.strip("[]") or "127.0.0.1", int(port))


def announce(running: "Daemon") -> None:
    """Say where it is and what comes next."""
    from softarm.daemon.stop.terminal import is_offered

    leaves(lambda: _left(running))
    log = running.recorder.path
    left = None if running.latch is None else running.latch.left
    state = "disarmed" if left is None else f"stopped, as it was left ({in_commands(left)}): `softarm acknowledge`"
    click.echo(f"softarm: serving {running.url} (API: {running.url}/docs), {state}")
    click.echo(f"softarm: recording {log}" if log else "softarm: not recording (recorder.enabled is false)")
    if running.foxglove is not None:
        click.echo(f"softarm: live for Foxglove at {running.foxglove.url} (open a connection, Foxglove WebSocket)")
    key = "; space or s here is an emergency stop" if is_offered() else ""
    click.echo(f"softarm: stop: `softarm stop`, or POST {running.stop_url}{key}")
    click.echo("softarm: next: `softarm arm`, then `softarm goal reach -0.2 0.6`; Ctrl-C ends")
