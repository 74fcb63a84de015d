"""`softarm events`: show the events of the running daemon or of a log."""

import json
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import click

from softarm.cli.shared.client import Remote, remote
from softarm.cli.shared.completion import logs
from softarm.cli.shared.options import FILE
from softarm.cli.shared.printing import clock

Json = dict[str, Any]
POLL_S = 0.5
PAGE = 1000  # the daemon's maximum per request


@click.command()
@click.argument("log", type=FILE, required=False, shell_complete=logs)
@click.option(
    "--limit", type=click.IntRange(1, PAGE), default=50, show_default=True, help="Number of events, newest last."
)
@click.option("--follow", is_flag=True, help="Keep showing new ones until Ctrl-C.")
@click.option("--json", "as_json", is_flag=True, help="Print one line of JSON per event.")
@remote
def events(daemon: Remote, log: Path | None, limit: int, follow: bool, as_json: bool) -> None:
    """Show events: requests and their clients, mode changes, stops, goals, lost and recovered devices, faults.

    The daemon keeps the newest 1000 events; a LOG contains all of its own and ignores --limit.

    \b
    Examples:
      softarm events
      softarm events --follow
      softarm events --json logs/softarm-20260101T120000Z.mcap
    """
    if log is not None and follow:
        raise click.UsageError("a log does not grow here: leave LOG out to follow the running daemon")
    for event in _recorded(log) if log is not None else _live(daemon, limit, follow):
        click.echo(json.dumps(event) if as_json else f"{clock(event['time'])}  {event['text']}")


def _live(daemon: Remote, limit: int, follow: bool) -> Iterator[Json]:
    answer = daemon.get(f"/api/events?limit={limit}")
    yield from answer["events"]
    while follow:
        time.sleep(POLL_S)
        since, run = answer["newest"] or 0, answer["run"]
        answer = daemon.get(f"/api/events?since={since}&limit={PAGE}")
        if answer["run"] != run:
            # A restarted daemon counts from 1.
            answer = daemon.get(f"/api/events?since=0&limit={PAGE}")
        yield from answer["events"]


def _recorded(log: Path) -> Iterable[Json]:
    from pydantic import TypeAdapter

    from softarm.daemon.logbook import logs
    from softarm.schemas.events import Entry

    adapter = TypeAdapter(Entry)
    for entry in logs.read(log).entries():
        yield adapter.dump_python(entry, mode="json")
