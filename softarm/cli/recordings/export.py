"""`softarm logs export`: write recordings in formats of other programs."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import click

from softarm.cli.shared.errors import fail, writing
from softarm.cli.shared.options import FILE, FOLDER
from softarm.cli.shared.printing import waiting
from softarm.common.processes import bar

if TYPE_CHECKING:
    from softarm.daemon.logbook.logs import TickLog
    from softarm.recordings.tables import Form

FORMS = ("csv", "parquet", "foxglove", "lerobot")
LAYOUT = "softarm-layout.json"


@click.command()
@click.argument("files", metavar="LOG...", type=FILE, nargs=-1, required=True)
@click.option("--to", type=click.Choice(FORMS), required=True, help="Target format.")
@click.option(
    "--out",
    type=FOLDER,
    default="exported",
    show_default=True,
    help="Folder to write to; earlier exports there are replaced.",
)
def export(files: tuple[Path, ...], to: str, out: Path) -> None:
    """Write logs in formats of other programs.

    csv and parquet: a folder for each log, with one row per tick (ticks), the frames of the cameras and the readings of
    each device at their own stamps (mocap and others), and the events. Column names contain the unit. The folder is a
    trial, which `softarm diagnose` reads like the log.

    foxglove: a file for each log in wall-clock time, with a 3D scene, a journal and values to plot, and a layout to
    import into Foxglove (LAYOUT, import from file).

    lerobot: one dataset (format 3.0) of all logs, with an episode for each reach goal: the policy's inputs as
    observation.state, its actions, and next.success.

    \b
    Examples:
      softarm logs export --to csv logs/softarm-20260101T120000Z.mcap
      softarm logs export --to foxglove logs/softarm-20260101T120000Z.mcap
      softarm logs export --to parquet --out flights logs/*.mcap
      softarm logs export --to lerobot --out reach-dataset logs/*.mcap
    """
    from softarm.daemon.logbook import logs

    if to == "lerobot":
        _lerobot(files, out)
        return
    for file in files:
        try:
            with writing("choose another --out"):
                log = logs.read(file)
                out.mkdir(parents=True, exist_ok=True)
                if to == "foxglove":
                    click.echo(_foxglove(log, out))
                else:
                    click.echo(_tables(log, out / file.stem, "csv" if to == "csv" else "parquet"))
        except ModuleNotFoundError as error:
            _fail_without(error, to)


def _fail_without(error: ModuleNotFoundError, to: str) -> NoReturn:
    fail(f"--to {to} needs {error.name}, which is not installed: pip install 'softarm[diagnosis]'")


def _lerobot(logs: tuple[Path, ...], out: Path) -> None:
    """Write one dataset of all logs."""
    from softarm.recordings import lerobot

    try:
        with writing("choose another --out"), waiting("reading the logs"):
            made = lerobot.write(out, (episode for log in logs for episode in lerobot.episodes(log)))
    except ValueError as error:
        fail(str(error))
    except ModuleNotFoundError as error:
        _fail_without(error, "lerobot")
    left_out = f"; {made.left_out} incomplete goals left out" if made.left_out else ""
    click.echo(f"wrote {out}: {made.episodes} episodes ({made.reached} reached), {made.frames} frames{left_out}")


def _tables(log: "TickLog", folder: Path, form: "Form") -> str:
    """Write one log as tables and return a sentence about it."""
    from softarm.common import files
    from softarm.diagnosis.data import folder as trial_folder
    from softarm.diagnosis.data import mcap
    from softarm.recordings import tables

    folder.mkdir(parents=True, exist_ok=True)
    with progress(log) as advance:
        ticks = tables.ticks(log, advance)
    tables.write(folder / f"ticks.{form}", ticks)
    tables.write(folder / f"events.{form}", tables.events(log, tuple(log.entries())))
    trial_folder.write(mcap.read(log.path), folder, form)
    files.write_text(folder / "about.json", tables.about(log))
    return f"wrote {folder}: {len(ticks['t_s'])} ticks over {log.duration_s:.1f} s"


def _foxglove(log: "TickLog", folder: Path) -> str:
    """Write one log and the layout for Foxglove, and return a sentence about it."""
    from softarm.common import files
    from softarm.recordings.foxglove import export as foxglove

    target = folder / f"{log.path.stem}-foxglove.mcap"
    with progress(log) as advance:
        foxglove.export(log, target, log.entries(), advance)
    files.write_text(folder / LAYOUT, foxglove.layout())
    size = f"{target.stat().st_size / 1e6:.1f} MB, the log has {log.path.stat().st_size / 1e6:.1f}"
    return f"wrote {target} ({size}) and {folder / LAYOUT}"


@contextmanager
def progress(log: "TickLog") -> Iterator[Callable[[], None]]:
    """Show a progress bar for a long log; call the yielded function for every message."""
    every, read = 1000, 0
    with bar(f"reading {log.path.name}", log.records) as shown:

        def advance() -> None:
            nonlocal read
            read += 1
            if read % every == 0:
                shown.advance(every)

        yield advance
