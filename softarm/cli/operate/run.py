"""`softarm run`: run the daemon on the robot or on a robot simulated in this process."""

import os
import signal
import subprocess
import sys
import threading
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.shared.client import options_for, url_of
from softarm.cli.shared.console import config_option, flown_model, model_option, prepared
from softarm.cli.shared.errors import leaves, left_now

if TYPE_CHECKING:
    from softarm.daemon.assembly import Daemon
    from softarm.daemon.foxglove.publisher import FoxglovePublisher
    from softarm.schemas.config import Api, Config


@click.command()
@config_option
@click.option("--simulated", is_flag=True, help="Use a robot simulated in this process instead of real devices.")
@model_option
@click.option("--port", type=click.IntRange(0, 65535), help="Port of the API instead of api.port; 0: any free one.")
@click.option("--open", "to_open", is_flag=True, help="Open the dashboard in the browser when it answers.")
@click.option(
    "--foxglove",
    metavar="[[HOST:]PORT]",
    is_flag=False,
    flag_value="8765",
    help="Serve live data to Foxglove, view only; on this computer only unless HOST is given.  [8765]",
)
def run(
    config_file: Path | None,
    simulated: bool,
    model_file: Path | None,
    port: int | None,
    to_open: bool,
    foxglove: str | None,
) -> None:
    """Run the control daemon until Ctrl-C or SIGTERM.

    It starts disarmed. Control it over REST, on the dashboard, or with `softarm arm`, `goal`, `status` and `stop`.

    \b
    Examples:
      softarm run --config softarm.yaml        on the robot
      softarm run --simulated --open           without hardware, with the dashboard in the browser
      softarm run --simulated --foxglove       also live in Foxglove, at ws://127.0.0.1:8765
      softarm run --config twin.yaml           on the twin started by `softarm twin --config twin.yaml`
    """
    import logging

    from softarm.daemon import assembly
    from softarm.daemon.runtime.devices import real_devices, simulated_devices

    if config_file is None and not simulated:
        raise click.UsageError(
            "no robot chosen: use --config FILE for real devices (`softarm config new` writes one), or --simulated"
        )
    if model_file is not None and not simulated:
        raise click.UsageError("--model is for a simulated robot: add --simulated, or give it to `softarm twin`")
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(name)s: %(message)s")
    logging.getLogger("uvicorn").setLevel(logging.WARNING)
    leaves("the daemon had not started")
    config = prepared(config_file, wires=not simulated, port=port)
    publisher = None if foxglove is None else _publisher(config, foxglove)
    hold_s = config.drivers.rail.hold_s
    devices = simulated_devices(flown_model(model_file), hold_s) if simulated else real_devices(config)
    ended = assembly.run(config, devices, partial(announce, to_open=to_open), foxglove=publisher)
    if ended == signal.SIGINT:
        raise KeyboardInterrupt
    click.echo(f"ended: {left_now()}", err=True)


def _left(running: "Daemon") -> str:
    """Return the text on the state that an ended daemon leaves."""
    last = running.loop.snapshot
    latched = last is not None and last.estop != "clear" and running.latch is not None
    acknowledge = f"`softarm acknowledge{options_for(_answering(running))}`"
    stop = f"; the emergency stop stays latched until {acknowledge} after the next start" if latched else ""
    log = running.recorder.path
    return f"the drive is off, the muscle vented{stop}" + (f"; {log} is closed" if log else "")


def _publisher(config: "Config", address: str) -> "FoxglovePublisher":
    """Return the Foxglove server at [HOST:]PORT."""
    from softarm.daemon.foxglove.publisher import FoxglovePublisher

    host, _, port = address.rpartition(":")
    if not (port.isdecimal() and int(port) < 65536):
        raise click.UsageError(f"--foxglove {address}: allowed PORT or HOST:PORT, PORT 0 to 65535 (0: any)")
    return FoxglovePublisher(config, host.strip("[]") or "127.0.0.1", int(port))


def announce(running: "Daemon", to_open: bool) -> None:
    """Print the daemon's address, its state and the next commands, and open its page if asked."""
    from softarm.daemon.stop.terminal import is_offered

    leaves(lambda: _left(running))
    log = running.recorder.path
    left = None if running.latch is None else running.latch.left
    address = options_for(_answering(running))
    state = "disarmed"
    if left is not None:
        state = f"stopped since its last run ({left}): `softarm acknowledge{address}`"
    click.echo(f"softarm: serving {running.url} (API: {running.url}/docs), {state}")
    click.echo(f"softarm: recording {log}" if log else "softarm: not recording (recorder.enabled is false)")
    if running.foxglove is not None:
        click.echo(f"softarm: live for Foxglove at {running.foxglove.url} (open a connection, Foxglove WebSocket)")
    if (ros := running.config.ros).router is not None:
        click.echo(f"softarm: ROS 2 topics under /{ros.name} at {ros.router}, commands: {ros.commands}")
    key = "; space or s here is an emergency stop" if is_offered() else ""
    click.echo(f"softarm: stop: `softarm stop{address}`, or POST {running.stop_url}{key}")
    click.echo(f"softarm: next: `softarm arm{address}`, then `softarm goal reach -0.2 0.6{address}`; Ctrl-C ends")
    if to_open:
        open_page(url_of(_answering(running)))


def _answering(running: "Daemon") -> "Api":
    """Return the API's settings with the port in use."""
    return running.config.api.model_copy(update={"port": running.port})


_DESKTOP = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")
# A browser must not inherit the daemon's real-time priority.
_CODE = """
import os, sys
os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
import webbrowser
sys.exit(not webbrowser.open(sys.argv[1]))
"""


def open_page(url: str) -> threading.Thread:
    """Open an address in the browser, or print that there is none.

    Returns at once, with the thread that waits for the answer. The browser has no terminal, so none in text mode takes
    the daemon's.
    """
    thread = threading.Thread(target=_open, args=(url,), name="browser", daemon=True)
    thread.start()
    return thread


def _open(url: str) -> None:
    command, null = [sys.executable, "-c", _CODE, url], subprocess.DEVNULL
    if (
        not any(map(os.environ.get, _DESKTOP))
        or subprocess.run(command, stdin=null, stdout=null, stderr=null, start_new_session=True).returncode
    ):
        click.echo(f"no browser here: open {url} in one", err=True)
