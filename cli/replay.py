"""`softarm replay`: a recorded log through the same tick; it must give the same commands."""

import sys
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.errors import fail
from softarm.cli.options import FILE

if TYPE_CHECKING:
    from softarm.daemon.shell.replay import Replayed

SHOWN = 10


@click.command()
@click.argument("files", metavar="LOG...", type=FILE, nargs=-1, required=True)
def replay(files: tuple[Path, ...]) -> None:
    """Run a log's inputs through the tick again and compare every command, bit for bit.

    Ends with 1 when a tick comes out otherwise: the software, a policy file or the configuration has changed. Where the
    log leaves ticks out, as it does while the arm is switched off and still, it says how many. Several logs are the
    parts of one run, in their order; each of them can be replayed by itself, too.

    \b
    Examples:
      softarm replay logs/softarm-20260101T120000Z.mcap
      softarm replay logs/softarm-20260101T*.mcap          a run that left several
    """
    from softarm.daemon.logbook import logs
    from softarm.daemon.shell.replay import replay as replay_log
    from softarm.policies import registry
    from softarm.policies.base import PolicyError
    from softarm.recordings.mcap_file import LogError

    try:
        parts = logs.parts(files)
        config = parts[0].config
        ticks = chain.from_iterable(part.ticks() for part in parts)
        replayed = replay_log(ticks, config, lambda name: registry.load(name, config.policies))
    except (LogError, PolicyError) as error:
        fail(str(error))
    for part in parts:
        click.echo(part.ending)
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
    for gaps in (armed, off):
        if gaps and gaps[0].after is None:
            yield f"the log begins at tick {gaps.pop(0).tick} of its run: an earlier file holds what was before"
    if off:
        missing, seconds = sum(gap.missing for gap in off), sum(gap.seconds for gap in off)
        yield f"not in this log: {missing} ticks ({seconds:.0f} s) of an arm that was switched off and still"
    for gap in armed[:SHOWN]:
        yield (
            f"tick {gap.tick}: the {gap.missing} before it are not in this log, and the drive was on: "
            "what follows may differ for that alone"
        )
    if unsure := replayed.ticks - replayed.compared:
        yield (
            f"run but not compared: {unsure} ticks after some that are missing: the first few, and of a goal that was "
            "flown there all"
        )
