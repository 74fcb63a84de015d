"""`softarm logs view`: play a log in the browser."""

import webbrowser
from pathlib import Path

import click

from softarm.cli.shared.options import FILE, write


@click.command(short_help="Play a recording in the browser.")
@click.argument("log", type=FILE, required=False)
@click.option("--out", type=FILE, help="Page to write.  [default: LOG with .html, in this folder]")
@click.option("--open/--no-open", "to_open", default=True, help="Open the page in the browser.")
@click.option("--layout", type=FILE, help="Only write the layout for Foxglove to this file.")
def view(log: Path | None, out: Path | None, to_open: bool, layout: Path | None) -> None:
    """Write a page that plays a log: the arm on a time slider, synchronous charts, and the events.

    The page is one file without external content, to open anywhere and to send. An hour of flight is about 7 MB, and no
    page exceeds about 9 MB: longer logs show every second tick, every fourth, and so on.

    \b
    Examples:
      softarm logs view logs/softarm-20260101T120000Z.mcap
      softarm logs view --out swing.html --no-open logs/softarm-20260101T120000Z.mcap
      softarm logs view --layout softarm-layout.json        for Foxglove
    """
    from softarm.cli.recordings.export import progress
    from softarm.daemon.logbook import logs
    from softarm.recordings import player
    from softarm.recordings.foxglove import export

    if layout is not None:
        write(layout, export.layout())
    if log is None:
        if layout is None:
            raise click.UsageError("which log? `softarm logs list` lists them")
        return
    opened = logs.read(log)
    with progress(opened) as advance:
        page = player.page(opened, opened.entries(), advance)
    out = out or Path(f"{log.stem}.html")
    write(out, page)
    if to_open and not webbrowser.open(out.absolute().as_uri()):
        click.echo(f"no browser here: open {out} in one", err=True)
