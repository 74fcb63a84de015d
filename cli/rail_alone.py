"""A drive has one master: for as long as a tool of `softarm rail` has it, no daemon does."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

from softarm.cli.errors import fail

if TYPE_CHECKING:
    from softarm.schemas.config import Config


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
