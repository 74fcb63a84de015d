"""Exclusive access to the drive for the tools of `softarm rail`, since a drive has one master."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

from softarm.cli.shared.errors import fail

if TYPE_CHECKING:
    from softarm.schemas.config import Config


@contextmanager
def relay_held(config: "Config", wanted: bool) -> Iterator[Callable[[], object]]:
    """Yield a function that keeps the board's relay closed while it is called; it does nothing if not wanted."""
    if not wanted:
        yield lambda: None
        return
    from softarm.drivers.rail.commissioning.relay import Relay

    with Relay(config.drivers.regulator) as relay:
        yield relay.hold


@contextmanager
def only_one(config: "Config") -> Iterator[None]:
    """Keep daemons from using this axis while the context lasts; end the command if one does."""
    from softarm.daemon.config.places import latch_path
    from softarm.daemon.doctor.ports import is_connected
    from softarm.daemon.stop.latch import LatchError, LatchKeeper

    drive = config.drivers.rail
    keeper = LatchKeeper(latch_path(config))
    try:
        keeper.start()
    except LatchError as error:
        fail(f"the drive has one master at a time: {error}")
    try:
        if is_connected(drive.host, drive.port):
            end = "end the daemon (Ctrl-C where it runs, or `systemctl stop softarmd`), then wait 3 s"
            fail(f"{drive.host}:{drive.port} is in use by another program, and accepts one master: {end}")
        if keeper.left is not None:
            click.echo(f"the robot's stop stays latched: {keeper.left}", err=True)
        yield
    finally:
        keeper.stop()
