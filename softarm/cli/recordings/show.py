"""`softarm logs show`: print length, policies and events of a recording."""

from pathlib import Path

import click

from softarm.cli.recordings.events import show_event
from softarm.cli.shared.completion import logs
from softarm.cli.shared.options import FILE
from softarm.cli.shared.printing import print_option


@click.command(short_help="Show length, end, policies and events.")
@click.argument("log", type=FILE, shell_complete=logs)
@print_option
def show(log: Path, as_json: bool) -> None:
    """Show a recording: its length and end, its policies, and all of its events. With --json, the events alone.

    \b
    Examples:
      softarm logs show logs/softarm-20260101T120000Z.mcap
      softarm logs show --json logs/softarm-20260101T120000Z.mcap
    """
    from pydantic import TypeAdapter

    from softarm.daemon.logbook import logs as recordings
    from softarm.schemas.events import Entry

    opened, adapter = recordings.read(log), TypeAdapter(Entry)
    if not as_json:
        click.echo(opened.ending)
        click.echo(f"policies: {', '.join(dict.fromkeys(each['name'] for each in opened.policies)) or 'none'}")
    for entry in opened.entries():
        show_event(adapter.dump_python(entry, mode="json"), as_json)
