"""`softarm events`: show the events of the running daemon."""

import json
import time
from collections.abc import Iterator
from typing import Any

import click

from softarm.cli.shared.client import Remote, remote
from softarm.cli.shared.console import clock

Json = dict[str, Any]
POLL_S = 0.5
PAGE = 1000  # the daemon's maximum per request


@click.command()
@click.option(
    "--limit", type=click.IntRange(1, PAGE), default=50, show_default=True, help="Number of events, newest last."
)
@click.option("--follow", is_flag=True, help="Keep showing new ones until Ctrl-C.")
@click.option("--json", "as_json", is_flag=True, help="Print one line of JSON per event.")
@remote
def events(daemon: Remote, limit: int, follow: bool, as_json: bool) -> None:
    """Show events: requests and their clients, mode changes, stops, goals, lost and recovered devices, faults.

    The daemon keeps the newest 1000 events. `softarm logs show LOG` shows those of a recording.

    \b
    Examples:
      softarm events
      softarm events --follow
      softarm events --limit 1000 --json
    """
    for event in _live(daemon, limit, follow):
        show_event(event, as_json)


def show_event(event: Json, as_json: bool) -> None:
    """Print one event on one line."""
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
