"""A drive has one master: for as long as a tool of `softarm rail` has it, no daemon does."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.errors import fail

if TYPE_CHECKING:
    from softarm.schemas.config import Config


def configuration(file: Path) -> "Config":
    """The file's. Ends the command with all that is wrong with it."""
    from softarm.daemon.config.configuration import ConfigurationError, load

    try:
        return load(file)
    except ConfigurationError as error:
        fail(str(error))


@contextmanager
def relay_held(config: "Config", wanted: bool) -> Iterator[Callable[[], object]]:
    """What holds the board's relay closed for as long as it is called; nothing, where that is not wanted."""
    if not wanted:
        yield lambda: None
        return
    from softarm.drivers.rail.commissioning.relay import Relay

    with Relay(config.drivers.regulator) as relay:
        yield relay.hold


@contextmanager
def only_one(config: "Config") -> Iterator[None]:
    """While this lasts no daemon leads this axis, and none begins. Ends the command where one does."""
    from softarm.daemon.doctor.ports import is_connected
    from softarm.daemon.stop.latch import LatchError, LatchKeeper, latch_path

    drive = config.drivers.rail
    keeper = LatchKeeper(latch_path(config))
    try:
        keeper.start()
    except LatchError as error:
        fail(f"the drive has one master at a time: {error}")
    try:
        if is_connected(drive.host, drive.port):
            end = "end the daemon (Ctrl-C where it runs, or `systemctl stop softarmd`), then wait 3 s"
            fail(f"{drive.host}:{drive.port} is held by another program of this computer, and has one master: {end}")
        if keeper.left is not None:
            click.echo(f"the robot was stopped, and stays so: {keeper.left}", err=True)
        yield
    finally:
        keeper.stop()
