"""Waiting for the end of a goal."""

import time
from typing import Any

import click

from softarm.cli.shared.client import Remote
from softarm.cli.shared.errors import fail
from softarm.cli.shared.interrupt import leaves
from softarm.cli.shared.printing import print_json, waiting

POLL_S = 0.1


def follow(
    daemon: Remote, answer: dict[str, Any], doing: str, wait: bool, as_json: bool, seconds: float | None = None
) -> None:
    """Report a goal, after its end with `wait` or `seconds`. Exits with 1 when it is not reached.

    Args:
        daemon: The daemon that has the goal.
        answer: Its answer to the request that set the goal.
        doing: Text for a goal that is running.
        wait: Whether to wait for the end.
        as_json: Whether to print JSON.
        seconds: Time after which the goal is cancelled.
    """
    if not wait and seconds is None:
        if as_json:
            print_json(daemon.get("/api/goal"))
        else:
            click.echo(doing)
        return
    leaves(f"the daemon continues with the goal; {daemon.command('goal cancel')} ends it")
    with waiting(doing):
        ended = _end(daemon, answer["goal"]["number"], seconds)
    if as_json:
        print_json(ended)
    if ended["state"] == "cancelled" and seconds is not None and ended["time_s"] >= seconds - POLL_S:
        done = f"cancelled after {ended['time_s']:.2f} s, as requested"
    elif ended["state"] != "reached":
        fail(f"{ended['state']}: {ended['reason']}")
    elif ended["closest_m"] is None:
        done = f"played to its end in {ended['time_s']:.2f} s"
    else:
        done = f"reached in {ended['time_s']:.2f} s, closest {ended['closest_m']:.3f} m"
    if not as_json:
        click.echo(done)


def _end(daemon: Remote, number: int, seconds: float | None) -> dict[str, Any]:
    """Poll the goal until it ends by the daemon's time limit, or cancel it after `seconds`."""
    over_s = None if seconds is None else time.monotonic() + seconds
    while (now := daemon.get("/api/goal"))["state"] == "running" and now["number"] == number:
        if over_s is not None and time.monotonic() >= over_s:
            daemon.request("DELETE", "/api/goal")
            over_s = None
        time.sleep(POLL_S)
    if now["number"] != number:
        fail(f"another goal has replaced this one: see {daemon.command('status')}")
    return dict(now)
