"""`softarm logs`: the daemon's recordings."""

from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

import click

from softarm.cli.errors import fail
from softarm.cli.interrupt import leaves
from softarm.cli.logs_export import export
from softarm.cli.printing import print_json, print_option
from softarm.cli.remote import Remote, remote


@click.group(invoke_without_command=True)
@print_option
@remote
@click.pass_context
def logs(context: click.Context, daemon: Remote, as_json: bool) -> None:
    """List the recordings, newest first: when last written, size, length, and where each lies.

    \b
    Examples:
      softarm logs
      softarm logs recover logs            mend those that a kill or a full disk has cut off
      softarm logs export --to csv LOG     tables for other programs
    """
    if context.invoked_subcommand is not None:
        return
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


logs.add_command(export)


@logs.command()
@click.argument("paths", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
def recover(paths: tuple[Path, ...]) -> None:
    """Mend logs that were cut off, by a kill or a full disk; PATHS are logs or folders of them.

    All whole records are kept, compressed and with an index; until then the old file stays. A log that is finished, or
    that a daemon still writes, is left alone. Ends with 1 when one could not be mended.

    \b
    Examples:
      softarm logs recover logs
      softarm logs recover logs/softarm-20260101T120000Z.mcap
    """
    files = [file for path in paths for file in (sorted(path.glob("*.mcap")) if path.is_dir() else [path])]
    if not files:
        fail(f"{', '.join(map(str, paths))}: no logs there; name the recorder's directory or a log")
    leaves("logs that were mended stay so; the others are as they were")
    problems = []
    for file in files:
        for sentence, mended in _recovered(file):
            click.echo(sentence, err=not mended)
            problems += [] if mended else [sentence]
    if problems:
        raise SystemExit(1)


def _recovered(path: Path) -> Iterator[tuple[str, bool]]:
    """Mend one log: what became of it, and whether it is well now."""
    from softarm.recordings import finishing, mcap_file

    try:
        if mcap_file.is_finished(path):
            yield f"{path}: is finished, nothing to mend", True
            return
        if finishing.is_held(path):
            yield f"{path}: is being written by a running daemon, left alone", True
            return
        before = path.stat().st_size
        log = finishing.recover(path)
    except OSError as error:
        yield f"{path}: cannot be mended ({error.strerror}): make room, or make file and folder writable", False
        return
    except mcap_file.LogError as error:
        yield str(error), False
        return
    if log.finished:
        size = f"{before / 1e6:.1f} MB, now {path.stat().st_size / 1e6:.1f} MB"
        yield f"{path}: mended; {log.records} whole records over {log.duration_s:.2f} s ({size})", True
    else:
        yield f"{path}: holds no whole record, left as it is; delete it", False
