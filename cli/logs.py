"""`softarm logs`: the daemon's recordings."""

from datetime import datetime

import click

from softarm.cli.remote import Remote, remote


@click.command()
@remote
def logs(daemon: Remote) -> None:
    """List the recordings, newest first: when last written, size, length, and where each lies.

    \b
    Example:
      softarm logs
    """
    answer = daemon.get("/api/logs")
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
