"""`softarm view`: a log in the browser."""

import webbrowser
from pathlib import Path

import click

from softarm.cli.errors import fail
from softarm.cli.options import FILE, write


@click.command()
@click.argument("log", type=FILE, required=False)
@click.option("--out", type=FILE, help="The page to write.  [default: LOG with .html, in this folder]")
@click.option("--open/--no-open", "to_open", default=True, help="Open it in the browser.")
@click.option("--layout", type=FILE, help="Instead, write the layout for Foxglove to this file.")
def view(log: Path | None, out: Path | None, to_open: bool, layout: Path | None) -> None:
    """Make a page that plays a log: the arm on a time slider, charts on the same time, what happened.

    It is one file that fetches nothing, to open anywhere and to send. An hour of flight is about 7 MB, and no page is
    larger than some 9: of a longer log every second tick is shown, every fourth, and so on.

    \b
    Examples:
      softarm view logs/softarm-20260101T120000Z.mcap
      softarm view --out swing.html --no-open logs/softarm-20260101T120000Z.mcap
      softarm view --layout softarm-layout.json        for Foxglove; `softarm logs export --to foxglove` makes its files
    """
    from softarm.cli.logs_export import progress
    from softarm.daemon.logbook import logs
    from softarm.recordings import player
    from softarm.recordings.foxglove import export
    from softarm.recordings.mcap_file import LogError

    if layout is not None:
        write(layout, export.layout())
    if log is None:
        if layout is None:
            raise click.UsageError("which log? `softarm logs` lists them")
        return
    try:
        opened = logs.read(log)
        with progress(opened) as advance:
            page = player.page(opened, opened.entries(), advance)
    except LogError as error:
        fail(str(error))
    out = out or Path(f"{log.stem}.html")
    write(out, page)
    if to_open and not webbrowser.open(out.absolute().as_uri()):
        click.echo(f"no browser here: open {out} in one", err=True)
