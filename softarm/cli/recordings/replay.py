"""`softarm logs replay`: run a recorded log through the tick again and compare the commands."""

import sys
from itertools import chain
from pathlib import Path

import click

from softarm.cli.shared.completion import logs
from softarm.cli.shared.interrupt import leaves
from softarm.cli.shared.options import FILE
from softarm.cli.shared.printing import waiting


@click.command(short_help="Compare a log's commands with the tick, bit for bit.")
@click.argument("files", metavar="LOG...", type=FILE, nargs=-1, required=True, shell_complete=logs)
def replay(files: tuple[Path, ...]) -> None:
    """Run a log's inputs through the tick again and compare every command, bit for bit.

    Exits with 1 if a tick differs: the software, a policy file or the configuration has changed. Ticks that the log
    omits, as it does while the arm is disarmed and still, are counted. Several logs are parts of one run in their
    order; each can also be replayed alone.

    \b
    Examples:
      softarm logs replay logs/softarm-20260101T120000Z.mcap
      softarm logs replay logs/softarm-20260101T*.mcap          a run that left several
    """
    from softarm.daemon.logbook import logs as recordings
    from softarm.daemon.runtime.replay import describe
    from softarm.daemon.runtime.replay import replay as replay_log
    from softarm.policies import registry

    leaves("nothing was changed")
    parts = recordings.parts(files)
    config = parts[0].config
    ticks = chain.from_iterable(part.ticks() for part in parts)
    with waiting("running the log through the tick again"):
        replayed = replay_log(ticks, config, lambda name: registry.load(name, config.policies))
    for part in parts:
        click.echo(part.ending)
    *sentences, outcome = describe(replayed)
    for sentence in sentences:
        click.echo(sentence)
    click.echo(outcome, err=bool(replayed.differences))
    sys.exit(bool(replayed.differences))
