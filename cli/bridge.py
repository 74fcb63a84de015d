"""`softarm bridge`: what other people's motion capture streams, as the daemon's frames."""

import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.bridge_calibrate import calibrate
from softarm.cli.bridge_screen import look, screen
from softarm.cli.bridge_settings import server_option, settings
from softarm.cli.errors import fail
from softarm.cli.interrupt import NOTHING, leaves
from softarm.cli.options import FILE
from softarm.cli.printing import print_option
from softarm.cli.verbs import Verbs

if TYPE_CHECKING:
    from softarm.drivers.bridge.bridging import Bridging, Status

SHOWN_S, PRINTED_S = 0.2, 1.0  # between two status lines: of a terminal, of --json
PRIORITY = 20  # as the control loop's own: cameras do not wait for other programs


@click.group(cls=Verbs)
def bridge() -> None:
    """Bring what motion capture sees to the daemon; find how the cameras' room lies to the robot.

    \b
    Examples:
      softarm bridge natnet --server 192.168.1.10 --once        who streams, and what
      softarm bridge calibrate --server 192.168.1.10            writes bridge.yaml
      softarm bridge natnet --config bridge.yaml                beside `softarm run`
    """


@bridge.command()
@server_option
@click.option("--config", "config_file", type=FILE, help="bridge.yaml; without it the room is taken as it stands.")
@click.option("--once", is_flag=True, help="Look for a second, print what is seen; publish nothing.")
@print_option
def natnet(server: str | None, config_file: Path | None, once: bool, as_json: bool) -> None:
    """Publish the rigid bodies that OptiTrack's Motive streams, until Ctrl-C or SIGTERM.

    Daemon and Motive may come later, and go and come again. What changes is told in a line; on a terminal the last
    line says how it goes. With --json that is an object a second. docs/bridge.md: what to set in Motive.

    \b
    Examples:
      softarm bridge natnet --server 192.168.1.10 --once
      softarm bridge natnet --config bridge.yaml
      softarm bridge natnet --config bridge.yaml --json > bridge.jsonl
    """
    from softarm.daemon.shell import realtime
    from softarm.drivers.base import DeviceError
    from softarm.drivers.bridge.bridging import Bridging
    from softarm.drivers.bridge.client import Client
    from softarm.drivers.bridge.publisher import Publisher

    config, address = settings(server, config_file)
    if once:
        leaves(NOTHING)
        look(config, address, as_json)
        return
    leaves("nothing is published any more; an arm that flew by it stops softly")
    ended = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: ended.set())
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background commands are deaf to it
    realtime.outrank_other_programs(PRIORITY)
    if config_file is None:
        click.echo(
            "not calibrated: the room is taken as it stands; `softarm bridge calibrate` finds how it lies", err=True
        )
    show, tell = screen(as_json)
    publisher = Publisher(config.daemon, tell)
    try:
        with Client(config, address, tell) as client:
            publisher.open()
            _carry(Bridging(config, client, publisher, tell), show, PRINTED_S if as_json else SHOWN_S, ended)
    except DeviceError as error:
        fail(str(error))
    finally:
        publisher.close()


def _carry(bridging: "Bridging", show: "Callable[[Status], None]", period_s: float, ended: threading.Event) -> None:
    """Until it is told to end."""
    due_s = 0.0
    while not ended.is_set():
        bridging.step()
        if (now_s := time.monotonic()) >= due_s:
            due_s = now_s + period_s
            show(bridging.status())


bridge.add_command(calibrate)
