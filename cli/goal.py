"""`softarm goal`: what the arm is to do."""

import time
from typing import Any

import click
from rich.console import Console

from softarm.cli.errors import fail
from softarm.cli.remote import Remote, remote

_POLL_S = 0.1


@click.group()
def goal() -> None:
    """Reach for a target, hold, or cancel. The arm must be armed.

    \b
    Examples:
      softarm goal reach -0.2 0.6 --wait
      softarm goal hold
      softarm goal cancel
    """


# A negative coordinate is not an option.
@goal.command(context_settings={"ignore_unknown_options": True})
@click.argument("y", type=float)
@click.argument("z", type=float)
@click.option("--wait", is_flag=True, help="Wait for the end; exit code 1 when the target is not reached.")
@remote
def reach(daemon: Remote, y: float, z: float, wait: bool) -> None:
    """Swing the tip to Y (along the rail) and Z (up), in metres.

    \b
    Examples:
      softarm goal reach -0.2 0.6
      softarm goal reach -0.35 0.65 --wait
    """
    answer = daemon.post("/api/goal", {"kind": "reach", "y_m": y, "z_m": z})
    for warning in answer["warnings"]:
        click.echo(f"warning: {warning}", err=True)
    if not wait:
        click.echo(f"reaching for y {y:g}, z {z:g} m")
        return
    with Console(stderr=True).status(f"reaching for y {y:g}, z {z:g} m"):
        ended = _wait_for_end(daemon, answer["goal"]["number"])
    if ended["state"] != "reached":
        fail(f"{ended['state']}: {ended['reason']}")
    click.echo(f"reached in {ended['time_s']:.2f} s, closest {ended['closest_m']:.3f} m")


@goal.command()
@remote
def hold(daemon: Remote) -> None:
    """Brake the cart and bring the muscle to its rest pressure, still armed.

    \b
    Example:
      softarm goal hold
    """
    daemon.post("/api/goal", {"kind": "hold"})
    click.echo("holding")


@goal.command()
@remote
def cancel(daemon: Remote) -> None:
    """End the running goal; the arm holds.

    \b
    Example:
      softarm goal cancel
    """
    daemon.request("DELETE", "/api/goal")
    click.echo("cancelled")


def _wait_for_end(daemon: Remote, number: int) -> dict[str, Any]:
    """Poll the goal until it has ended; the daemon's own time limit sees to that."""
    while (now := daemon.get("/api/goal"))["state"] == "running" and now["number"] == number:
        time.sleep(_POLL_S)
    if now["number"] != number:
        fail("another goal has taken its place: see `softarm status`")
    return dict(now)
