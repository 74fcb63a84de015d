"""`softarm bridge`: pass on motion capture of other systems to the daemon."""

import signal
import threading
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.cameras.calibrate import calibrate
from softarm.cli.cameras.screen import look, screen
from softarm.cli.cameras.settings import server_option, settings
from softarm.cli.shared.interrupt import NOTHING, leaves
from softarm.cli.shared.options import FILE
from softarm.cli.shared.printing import print_option
from softarm.cli.verbs import Verbs

if TYPE_CHECKING:
    from softarm.drivers.bridge.bridging import Bridging, Status

SHOWN_S = 0.2  # interval of the status on a terminal
PRINTED_S = 1.0  # interval of the objects of --json
PRIORITY = 20  # that of the control loop, since cameras do not wait for other programs


@click.group(cls=Verbs)
def bridge() -> None:
    """Pass on motion capture to the daemon, and find the pose of the cameras relative to the robot.

    \b
    Examples:
      softarm bridge natnet --server 192.168.1.10 --once        show the server and its bodies
      softarm bridge calibrate --server 192.168.1.10            write bridge.yaml
      softarm bridge natnet --config bridge.yaml                next to `softarm run`
    """


@bridge.command()
@server_option
@click.option(
    "--config", "config_file", type=FILE, help="bridge.yaml; without it the cameras' frame is used unchanged."
)
@click.option("--once", is_flag=True, help="Print the bodies seen within a second; publish nothing.")
@print_option
def natnet(server: str | None, config_file: Path | None, once: bool, as_json: bool) -> None:
    """Publish the rigid bodies that OptiTrack's Motive streams, until Ctrl-C or SIGTERM.

    Daemon and Motive may start later, and may restart. Changes are printed as lines; on a terminal the last line shows
    the current status. With --json one object per second is printed. docs/hardware/bridge.md describes the settings of
    Motive.

    \b
    Examples:
      softarm bridge natnet --server 192.168.1.10 --once
      softarm bridge natnet --config bridge.yaml
      softarm bridge natnet --config bridge.yaml --json > bridge.jsonl
    """
    from softarm.common import realtime
    from softarm.drivers.bridge.bridging import Bridging, Publisher
    from softarm.drivers.bridge.client import Client

    config, address = settings(server, config_file)
    if once:
        leaves(NOTHING)
        look(config, address, as_json)
        return
    leaves("publishing has ended; an arm in flight makes a soft stop")
    ended = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: ended.set())
    signal.signal(signal.SIGINT, signal.default_int_handler)  # shells ignore SIGINT in background commands
    realtime.outrank_other_programs(PRIORITY)
    if config_file is None:
        click.echo(
            "not calibrated: the room is taken as it stands; `softarm bridge calibrate` finds how it lies", err=True
        )
    show, log = screen(as_json)
    with closing(Publisher(config.daemon, log)) as publisher, Client(config, address, log) as client:
        publisher.open()
        _carry(Bridging(config, client, publisher, log), show, PRINTED_S if as_json else SHOWN_S, ended)


def _carry(bridging: "Bridging", show: "Callable[[Status], None]", period_s: float, ended: threading.Event) -> None:
    """Relay frames until the end is requested."""
    due_s = 0.0
    while not ended.is_set():
        bridging.step()
        if (now_s := time.monotonic()) >= due_s:
            due_s = now_s + period_s
            show(bridging.status())


bridge.add_command(calibrate)
