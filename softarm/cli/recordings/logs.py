"""`softarm logs`: list, show, play, replay, export and repair the daemon's recordings."""

from datetime import datetime
from pathlib import Path

import click

from softarm.cli.recordings.export import export
from softarm.cli.recordings.replay import replay
from softarm.cli.recordings.show import show
from softarm.cli.recordings.view import view
from softarm.cli.shared.client import Remote, remote
from softarm.cli.shared.errors import fail
from softarm.cli.shared.interrupt import leaves
from softarm.cli.shared.printing import print_json, print_option
from softarm.cli.verbs import Verbs


@click.group(cls=Verbs)
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


for verb in (show, view, replay, export):
    logs.add_command(verb)


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
    from softarm.recordings import finishing, mcap_file

    try:
        if mcap_file.is_finished(path):
            return f"{path}: is finished, nothing to repair", True
        if finishing.is_held(path):
            return f"{path}: is being written by a running daemon, left alone", True
        before = path.stat().st_size
        log = finishing.recover(path)
    except OSError as error:
        remedy = "free disk space, or make file and folder writable"
        return f"{path}: cannot be repaired ({error.strerror}): {remedy}", False
    except mcap_file.LogError as error:
        return str(error), False
    if not log.finished:
        return f"{path}: has no complete record and was not changed; delete it", False
    size = f"{before / 1e6:.1f} MB, now {path.stat().st_size / 1e6:.1f} MB"
    return f"{path}: repaired; {log.records} complete records over {log.duration_s:.2f} s ({size})", True
