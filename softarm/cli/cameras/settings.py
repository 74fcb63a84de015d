"""Settings of the cameras that the verbs of `softarm bridge` share."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from softarm.schemas.bridge import Bridge

server_option = click.option(
    "--server", metavar="ADDRESS", help="Computer that runs Motive; overrides the file's `server`."
)


def settings(server: str | None, config_file: Path | None) -> "tuple[Bridge, str]":
    """Return the bridge's configuration and the server's address; end the command if one is wrong."""
    from softarm.drivers.bridge.bridging import read
    from softarm.schemas.bridge import Bridge

    config = Bridge() if config_file is None else read(config_file)
    if (address := server or config.server) is None:
        raise click.UsageError("which cameras? --server ADDRESS of the computer that runs Motive, or --config FILE")
    return config, address
