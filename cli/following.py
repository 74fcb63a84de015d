"""A goal that was given, to its end."""

import time
from typing import Any

import click

from softarm.cli.errors import fail
from softarm.cli.interrupt import leaves
from softarm.cli.printing import print_json, waiting
from softarm.cli.remote import Remote

POLL_S = 0.1


def follow(
    daemon: Remote, answer: dict[str, Any], doing: str, wait: bool, as_json: bool, seconds: float | None = None
) -> None:
    """Say how a goal goes, once it has ended if that is to be waited for. Exit code 1 when it is not reached.

    answer: to the request that gave it. seconds: it is cancelled after so long, and waited for until then.
    """
    if not wait and seconds is None:
        if as_json:
            print_json(daemon.get("/api/goal"))
        else:
            click.echo(doing)
        return
    leaves("the daemon goes on with the goal; `softarm goal cancel` ends it")
    with waiting(doing):
        ended = _end(daemon, answer["goal"]["number"], seconds)
    if as_json:
        print_json(ended)
    if ended["state"] == "cancelled" and seconds is not None and ended["time_s"] >= seconds - POLL_S:
        done = f"cancelled after {ended['time_s']:.2f} s, as asked"
    elif ended["state"] != "reached":
        fail(f"{ended['state']}: {ended['reason']}")
    elif ended["closest_m"] is None:
        done = f"played to its end in {ended['time_s']:.2f} s"
    else:
        done = f"reached in {ended['time_s']:.2f} s, closest {ended['closest_m']:.3f} m"
    if not as_json:
        click.echo(done)


def _end(daemon: Remote, number: int, seconds: float | None) -> dict[str, Any]:
    """Poll the goal until it has ended: by the daemon's own time limit, or cancelled here after `seconds`."""
    over_s = None if seconds is None else time.monotonic() + seconds
    while (now := daemon.get("/api/goal"))["state"] == "running" and now["number"] == number:
        if over_s is not None and time.monotonic() >= over_s:
            daemon.request("DELETE", "/api/goal")
            over_s = None
        time.sleep(POLL_S)
    if now["number"] != number:
        fail("another goal has taken its place: see `softarm status`")
    return dict(now)
