"""`softarm check`: is the configuration sound, and what does it hold the arm to."""

from pathlib import Path

import click

from softarm.cli.errors import fail
from softarm.cli.printing import print_table


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
def check(file: Path) -> None:
    """Check a configuration FILE; print the limits in force and where each comes from.

    Exit code 1, with every mistake and its line, when the daemon would refuse the file.

    \b
    Example:
      softarm check softarm.yaml
    """
    from softarm.daemon.api.auth import AuthError, load_token
    from softarm.daemon.config.configuration import ConfigurationError, effective_limits, read
    from softarm.daemon.config.policies import policy_problems

    try:
        loaded = read(file)
    except ConfigurationError as error:
        fail(str(error))
    columns = ("limit", "value", "unit", "allowed, or how it follows", "from")
    print_table(columns, effective_limits(loaded), f"{file}: limits in force", width=140)
    problems = list(policy_problems(loaded))
    try:
        load_token(loaded.config.api)
    except AuthError as error:
        key = "host" if loaded.config.api.token_file is None else "token_file"
        problems.append(f"{loaded.place(('api', key))}: {error}")
    if problems:
        fail("\n".join(problems))
    click.echo(f"{file}: sound; starts with policy '{loaded.config.control.policy}'")
