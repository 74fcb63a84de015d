"""`softarm logs`: list, show, play, replay, export and repair the daemon's recordings."""

import sys
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from itertools import chain, product
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.recordings.events import show_event
from softarm.cli.shared import completion
from softarm.cli.shared.client import Remote, remote
from softarm.cli.shared.console import FILE, FOLDER, print_json, print_option, waiting, write
from softarm.cli.shared.errors import fail, failing, leaves
from softarm.common.processes import bar

if TYPE_CHECKING:
    from softarm.daemon.logbook.logs import TickLog
    from softarm.recordings.tables import Form

FORMS = ("csv", "parquet", "foxglove", "lerobot")
LAYOUT = "softarm-layout.json"


@click.group()
def logs() -> None:
    """List, show, play, replay, export and repair the daemon's recordings.

    \b
    Examples:
      softarm logs list
      softarm logs view LOG                play it in the browser
      softarm logs export --to csv LOG     tables for other programs
    """


@logs.command("list", short_help="List the recordings, newest first.")
@print_option
@remote
def list_(daemon: Remote, as_json: bool) -> None:
    """List the recordings, newest first, with the time of the last write, size, length and path.

    \b
    Example:
      softarm logs list
    """
    answer = daemon.get("/api/logs")
    if as_json:
        print_json(answer)
        return
    if not answer["logs"]:
        click.echo(f"no recordings yet in {answer['directory']}", err=True)
    for log in answer["logs"]:
        written = datetime.fromisoformat(log["modified"]).astimezone()
        length = "" if log["duration_s"] is None else f"{log['duration_s']:.1f} s"
        remark = "  (recording)" if log["recording"] else "" if log["finished"] else "  (unfinished)"
        click.echo(
            f"{written:%Y-%m-%d %H:%M:%S}  {log['bytes'] / 1e6:8.1f} MB  {length:>9}  "
            f"{answer['directory']}/{log['name']}{remark}"
        )


@logs.command(short_help="Show length, end, policies and events.")
@click.argument("log", type=FILE, shell_complete=completion.logs)
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


@logs.command(short_help="Play a recording in the browser.")
@click.argument("log", type=FILE, required=False, shell_complete=completion.logs)
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
    from softarm.daemon.logbook import logs as recordings
    from softarm.recordings import player
    from softarm.recordings.foxglove import converter

    if layout is not None:
        write(layout, converter.layout())
    if log is None:
        if layout is None:
            raise click.UsageError("which log? `softarm logs list` lists them")
        return
    opened = recordings.read(log)
    with progress(opened) as advance:
        page = player.page(opened, opened.entries(), advance)
    out = out or Path(f"{log.stem}.html")
    write(out, page)
    if to_open and not webbrowser.open(out.absolute().as_uri()):
        click.echo(f"no browser here: open {out} in one", err=True)


@logs.command(short_help="Compare a log's commands with the tick, bit for bit.")
@click.argument("files", metavar="LOG...", type=FILE, nargs=-1, required=True, shell_complete=completion.logs)
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


@logs.command()
@click.argument("files", metavar="LOG...", type=FILE, nargs=-1, required=True, shell_complete=completion.logs)
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
    from softarm.daemon.logbook import logs as recordings

    stems = [file.stem for file in files]
    if to != "lerobot" and (twice := [file for file in files if stems.count(file.stem) > 1]):
        raise click.UsageError(
            f"{' and '.join(map(str, twice))} have one name, which also names the export; allowed "
            "is each name once; export them one by one with different --out"
        )
    try:
        if to == "lerobot":
            click.echo(_lerobot(files, out))
            return
        for file in files:
            log = recordings.read(file)
            out.mkdir(parents=True, exist_ok=True)
            if to == "foxglove":
                click.echo(_foxglove(log, out))
            else:
                click.echo(_tables(log, out / file.stem, "csv" if to == "csv" else "parquet"))
    except ModuleNotFoundError as error:
        fail(f"--to {to} needs {error.name}, which is not installed: pip install 'softarm[diagnosis]'")


def _lerobot(logs: tuple[Path, ...], out: Path) -> str:
    """Write one dataset of all logs and return a sentence about it."""
    from softarm.recordings import lerobot

    with failing(ValueError), waiting("reading the logs"):
        made = lerobot.write(out, (episode for log in logs for episode in lerobot.episodes(log)))
    left_out = f"; {made.left_out} incomplete goals left out" if made.left_out else ""
    return f"wrote {out}: {made.episodes} episodes ({made.reached} reached), {made.frames} frames{left_out}"


def _tables(log: "TickLog", folder: Path, form: "Form") -> str:
    """Write one log as tables and return a sentence about it."""
    from softarm.common import files
    from softarm.diagnosis.data import folder as trial_folder
    from softarm.diagnosis.data import mcap
    from softarm.diagnosis.data.trials import ROBOT_CHANNELS, TrialError
    from softarm.recordings import tables

    folder.mkdir(parents=True, exist_ok=True)
    with progress(log) as advance:
        ticks = tables.ticks(log, advance)
    about = folder / "about.json"
    if about.exists():  # of an earlier export, whose other tables would mix with these
        for name, suffix in product(("ticks", "events", *ROBOT_CHANNELS), trial_folder.FORMS):
            (folder / f"{name}{suffix}").unlink(missing_ok=True)
    tables.write(folder / f"ticks.{form}", ticks)
    tables.write(folder / f"events.{form}", tables.events(log, tuple(log.entries())))
    files.write_text(about, tables.about(log))
    try:
        trial_folder.write(mcap.read(log.path), folder, form)
    except TrialError as error:  # no device has answered
        click.echo(error, err=True)
    return f"wrote {folder}: {len(ticks['t_s'])} ticks over {log.duration_s:.1f} s"


def _foxglove(log: "TickLog", folder: Path) -> str:
    """Write one log and the layout for Foxglove, and return a sentence about it."""
    from softarm.common import files
    from softarm.recordings.foxglove import converter as foxglove

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


@logs.command(short_help="Repair logs that were cut off.")
@click.argument("paths", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
def recover(paths: tuple[Path, ...]) -> None:
    """Repair logs that were cut off by a kill or a full disk; PATHS are logs or folders of them.

    All complete records are kept, compressed and with an index; the old file stays until then. Finished logs and logs
    that a daemon is writing are left alone. Exits with 1 if one could not be repaired.

    \b
    Examples:
      softarm logs recover logs
      softarm logs recover logs/softarm-20260101T120000Z.mcap
    """
    files = [file for path in paths for file in (sorted(path.glob("*.mcap")) if path.is_dir() else [path])]
    if not files:
        fail(f"{', '.join(map(str, paths))}: no logs there; give the recorder's directory or a log")
    leaves("repaired logs stay repaired; the others are unchanged")
    failed = False
    for file in files:
        sentence, is_valid = _recovered(file)
        click.echo(sentence, err=not is_valid)
        failed = failed or not is_valid
    if failed:
        raise SystemExit(1)


def _recovered(path: Path) -> tuple[str, bool]:
    """Repair one log; return a sentence about it and whether the log is valid now."""
    from softarm.recordings import log_file, mcap_file

    try:
        if mcap_file.is_finished(path):
            return f"{path}: is finished, nothing to repair", True
        if log_file.is_held(path):
            return f"{path}: is being written by a running daemon, left alone", True
        before = path.stat().st_size
        log = log_file.recover(path)
    except OSError as error:
        remedy = "free disk space, or make file and folder writable"
        return f"{path}: cannot be repaired ({error.strerror}): {remedy}", False
    except mcap_file.LogError as error:
        return str(error), False
    if not log.finished:
        return f"{path}: has no complete record and was not changed; delete it", False
    size = f"{before / 1e6:.1f} MB, now {path.stat().st_size / 1e6:.1f} MB"
    return f"{path}: repaired; {log.records} complete records over {log.duration_s:.2f} s ({size})", True
