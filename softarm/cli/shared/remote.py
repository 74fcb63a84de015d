"""Options of verbs that talk to a running daemon."""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from softarm.cli.shared.client import DEFAULT_URL, Remote
from softarm.cli.shared.interrupt import leaves
from softarm.cli.shared.options import FILE, token_of

__all__ = ["Remote", "remote"]


def remote(function: Callable[..., None]) -> Callable[..., None]:
    """Add --url and --token-file to a command and pass it the daemon as its first argument."""

    @click.option(
        "--url",
        envvar="SOFTARM_URL",
        default=DEFAULT_URL,
        show_default=True,
        show_envvar=True,
        help="The daemon's address.",
    )
    @click.option(
        "--token-file", type=FILE, help="File with the API's token; else $SOFTARM_TOKEN. Not needed on loopback."
    )
    @functools.wraps(function)
    def command(*args: Any, url: str, token_file: Path | None, **kwargs: Any) -> None:
        leaves("the daemon keeps running")
        with Remote(url, token_of(token_file)) as daemon:
            function(daemon, *args, **kwargs)

    return command
