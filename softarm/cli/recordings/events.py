"""`softarm events` and `softarm incidents`: events of the running daemon, and files of its emergency stops."""

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from softarm.cli.shared.client import Remote, remote
from softarm.cli.shared.completion import incident_files
from softarm.cli.shared.console import FILE, FOLDER, clock, print_json, print_option, write_bytes
from softarm.cli.shared.errors import fail

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
    answer, last = daemon.get(f"/api/events?limit={limit}"), 0
    while True:
        for event in answer["events"]:
            yield event
            last = event["number"]
        if not follow:
            return
        time.sleep(POLL_S)
        run = answer["run"]
        answer = daemon.get(f"/api/events?since={last}&limit={PAGE}")
        if answer["run"] != run:
            # A restarted daemon counts from 1.
            answer, last = daemon.get(f"/api/events?since=0&limit={PAGE}"), 0


LATEST = "latest"


@click.command()
@click.argument("name", required=False, shell_complete=incident_files)
@click.option("--out", type=FILE, help="File to write.  [default: NAME, in this folder]")
@click.option("--folder", type=FOLDER, help="List without a daemon: the folder of recorder.directory.")
@print_option
@remote
def incidents(daemon: Remote, name: str | None, out: Path | None, folder: Path | None, as_json: bool) -> None:
    """List the incident files of emergency stops, newest first. With NAME, fetch one; `latest` is the newest.

    Each is a zip to send: the log from 20 s before to 5 s after the stop (it can be replayed), the events, the
    configuration without secrets, and versions.

    \b
    Examples:
      softarm incidents
      softarm incidents latest --out stop.zip
      softarm incidents --folder logs
    """
    if name is None and out is not None:
        raise click.UsageError("--out is for one file: give its NAME, or `latest`")
    found = _listed(folder) if folder is not None else daemon.get("/api/incidents")
    if name is not None:
        _fetch(daemon, folder, found, name, out)
    elif as_json:
        print_json(found)
    elif not found["incidents"]:
        click.echo(f"no incident files in {found['directory']}: there was no emergency stop", err=True)
    else:
        for one in found["incidents"]:
            click.echo(f"{clock(one['time'])}  {one['bytes'] / 1e6:6.1f} MB  {one['name']}  {one['text']}")


def _listed(folder: Path) -> Json:
    """Return the list that a daemon with these logs would give."""
    from softarm.daemon.logbook import incidents as files

    if not folder.is_dir():
        fail(f"--folder {folder}: is not a folder; give the one of recorder.directory")
    listed = [entry.model_dump(mode="json") for entry in files.listing(folder)]
    return {"directory": str(folder / files.FOLDER), "incidents": listed}


def _fetch(daemon: Remote, folder: Path | None, found: Json, name: str, out: Path | None) -> None:
    from softarm.common.words import did_you_mean
    from softarm.daemon.logbook import incidents as files

    names = [one["name"] for one in found["incidents"]]
    if name == LATEST and names:
        name = names[0]
    if name not in names:
        hint = did_you_mean(name, names)
        fail(f"no incident file '{name}' in {found['directory']}; {hint}{daemon.command('incidents')} lists them")
    content = files.content(folder, name) if folder is not None else daemon.download(f"/api/incidents/{name}")
    if content is None:
        fail(f"{name}: no longer exists; {daemon.command('incidents')} lists the files")
    write_bytes(out or Path(name), content)
