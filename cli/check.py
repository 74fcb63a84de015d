"""`softarm check`: is the configuration sound, and what does it hold the arm to."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.errors import fail
from softarm.cli.tables import print_table

if TYPE_CHECKING:
    from softarm.daemon.config.configuration import Loaded


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
def check(file: Path) -> None:
    """Check a configuration FILE; print the limits in force and where each comes from.

    Exit code 1, with every mistake and its line, when the daemon would refuse the file.

    \b
    Example:
      softarm check softarm.yaml
    """
    from softarm.daemon.config.configuration import ConfigurationError, effective_limits, read

    try:
        loaded = read(file)
    except ConfigurationError as error:
        fail(str(error))
    columns = ("limit", "value", "unit", "allowed, or how it follows", "from")
    print_table(columns, effective_limits(loaded), f"{file}: limits in force", width=140)
    if problems := list(_policy_problems(loaded)):
        fail("\n".join(problems))
    click.echo(f"{file}: sound; starts with policy '{loaded.config.control.policy}'")


def _policy_problems(loaded: "Loaded") -> Iterator[str]:
    """Find what would keep the file's policies from flying; the one it starts with is loaded and tried out."""
    from softarm.policies import registry
    from softarm.policies.base import PolicyError

    config = loaded.config
    for name, entry in registry.available(config.policies).items():
        if name in config.policies and entry.error:
            yield f"{loaded.place(('policies', name))}: policies.{name}: {entry.error}"
    try:
        registry.load(config.control.policy, config.policies)
    except PolicyError as error:
        yield f"{loaded.place(('control', 'policy'))}: control.policy: {error}"
