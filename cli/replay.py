"""`softarm replay`: a recorded log through the same tick; it must give the same commands."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.errors import fail
from softarm.cli.options import FILE

if TYPE_CHECKING:
    from softarm.daemon.shell.replay import Replayed

SHOWN = 10


@click.command()
@click.argument("log", type=FILE)
def replay(log: Path) -> None:
    """Run a log's inputs through the tick again and compare every command, bit for bit.

    Ends with 1 when a tick comes out otherwise: the software, a policy file or the configuration has changed. Where the
    log leaves ticks out, as it does while the arm is switched off and still, it says how many.

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
        replayed = replay_log(recorded.ticks(), config, lambda name: registry.load(name, config.policies))
    except (LogError, PolicyError) as error:
        fail(str(error))
    click.echo(recorded.ending)
    differences = replayed.differences
    for difference in differences[:SHOWN]:
        click.echo(f"tick {difference.tick} {difference.field}: was {difference.recorded}, is {difference.replayed}")
    for sentence in _gaps(replayed):
        click.echo(sentence)
    if differences:
        click.echo(f"{len(differences)} differences in {replayed.compared} ticks", err=True)
        sys.exit(1)
    click.echo(f"{replayed.compared} ticks, every command the same")


def _gaps(replayed: "Replayed") -> Iterator[str]:
    """What the log does not hold, and what could not be compared for it."""
    armed = [gap for gap in replayed.gaps if gap.armed]
    off = [gap for gap in replayed.gaps if not gap.armed]
    if off and off[0].after is None:
        yield f"the log begins at tick {off.pop(0).tick} of its run: an earlier file holds what was before"
    if off:
        missing, seconds = sum(gap.missing for gap in off), sum(gap.seconds for gap in off)
        yield f"not in this log: {missing} ticks ({seconds:.0f} s) of an arm that was switched off and still"
    for gap in armed[:SHOWN]:
        yield (
            f"tick {gap.tick}: the {gap.missing} before it are not in this log, and the drive was on: "
            "what follows may differ for that alone"
        )
    if unsure := replayed.ticks - replayed.compared:
        yield f"run but not compared: {unsure} ticks, each one of the first few after some that are missing"
