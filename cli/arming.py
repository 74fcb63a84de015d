"""`softarm arm`, `disarm`, `stop`, `acknowledge`."""

import time

import click

from softarm.cli.errors import fail
from softarm.cli.interrupt import leaves
from softarm.cli.remote import Remote, remote

_PATIENCE_S = 1.0
_POLL_S = 0.05
_SETTLING, _SETTLES_S = "mocap_settling", 3.0  # the one refusal that ends by itself, and how long is waited for it


def wait_while(daemon: Remote, mode: str, why: str) -> dict[str, object]:
    """Poll until the daemon has left a mode; its own time limits end the wait. Says why, if that takes a while."""
    said, since_s = False, time.monotonic()
    while (status := daemon.get("/api/status"))["mode"] == mode:
        if not said and time.monotonic() - since_s > _PATIENCE_S:
            click.echo(why, err=True)
            said = True
        time.sleep(_POLL_S)
    return dict(status)


def settle(daemon: Remote) -> None:
    """Wait while nothing is against arming but that motion capture has just come up, as in a daemon's first second."""
    until_s = time.monotonic() + _SETTLES_S
    while time.monotonic() < until_s:
        status = daemon.get("/api/status")
        passing = {event["text"] for event in status["events"] if event["name"] == _SETTLING}
        if not passing or not passing.issuperset(status["arming_refusals"]):
            return
        time.sleep(_POLL_S)


@click.command()
@remote
def arm(daemon: Remote) -> None:
    """Give the daemon the actuators, and wait until it has them.

    Refused, with the reasons, while anything is missing or wrong; only motion capture that has just come up is waited
    for, 3 s at most.

    \b
    Example:
      softarm arm
    """
    leaves("the daemon was not asked to arm")
    settle(daemon)
    leaves("the daemon goes on arming; `softarm disarm` takes that back")
    daemon.post("/api/arm")
    status = wait_while(daemon, "arming", "waiting for drive and regulator")
    if status["mode"] != "armed":
        fail(f"not armed but {status['mode']}: {status.get('last_stop') or 'see `softarm status`'}")
    click.echo("armed")


@click.command()
@remote
def disarm(daemon: Remote) -> None:
    """Brake the cart, vent the muscle, hold until the arm is still (10 s at most), switch the drive off.

    \b
    Example:
      softarm disarm
    """
    leaves("the daemon goes on: it disarms once the arm hangs still")
    daemon.post("/api/disarm")
    click.echo(wait_while(daemon, "stopping", "holding the cart until the arm hangs still")["mode"])


@click.command()
@click.option(
    "--stop-port",
    type=click.IntRange(1, 65535),
    envvar="SOFTARM_STOP_PORT",
    show_envvar=True,
    help="The daemon's api.stop_port (default: the one after the port in --url).",
)
@remote
def stop(daemon: Remote, stop_port: int | None) -> None:
    """Emergency stop by software: brake, vent, and stay stopped until `softarm acknowledge`.

    It goes by the stop's own way, which nothing else can hold up, and over the API where that does not answer.
    It needs the network and the daemon. The button on the wall does not.

    \b
    Example:
      softarm stop
    """
    if not daemon.stop(stop_port):
        daemon.post("/api/stop")
    click.echo("stopped; latched until `softarm acknowledge`")


@click.command()
@remote
def acknowledge(daemon: Remote) -> None:
    """Release a latched emergency stop, once its cause is gone. The arm stays disarmed.

    \b
    Example:
      softarm acknowledge
    """
    daemon.post("/api/acknowledge")
    click.echo(daemon.get("/api/status")["mode"])
