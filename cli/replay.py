"""`softarm replay`: a recorded log through the same tick; it must give the same commands."""

import sys
from pathlib import Path

import click

from softarm.cli.errors import fail
from softarm.cli.options import FILE

SHOWN = 10


@click.command()
@click.argument("log", type=FILE)
def replay(log: Path) -> None:
    """Run a log's inputs through the tick again and compare every command, bit for bit.

    Ends with 1 when a tick comes out otherwise: the software, a policy file or the configuration has changed.

    \b
    Example:
      softarm replay logs/softarm-20260101T120000Z.mcap
    """
    from softarm.daemon.logbook import logs
    from softarm.daemon.shell.replay import replay as replay_log
    from softarm.policies import registry
    from softarm.policies.base import PolicyError
    from softarm.recordings.mcap_file import LogError

    try:
        recorded = logs.read(log)
        config = recorded.config
        ticks, differences = replay_log(recorded.ticks(), config, lambda name: registry.load(name, config.policies))
    except (LogError, PolicyError) as error:
        fail(str(error))
    click.echo(recorded.ending)
    for difference in differences[:SHOWN]:
        click.echo(f"tick {difference.tick} {difference.field}: was {difference.recorded}, is {difference.replayed}")
    if differences:
        click.echo(f"{len(differences)} differences in {ticks} ticks", err=True)
        sys.exit(1)
    click.echo(f"{ticks} ticks, every command the same")
