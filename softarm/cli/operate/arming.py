"""`softarm arm`, `disarm`, `stop`, `acknowledge`."""

import time

import click

from softarm.cli.shared.client import STOP_TIMEOUT_S, Remote, remote
from softarm.cli.shared.console import waiting
from softarm.cli.shared.errors import Failure, fail, leaves

_POLL_S = 0.05
# The one refusal that clears by itself, and how long to wait for it.
_SETTLING = "mocap_settling"
_SETTLES_S = 3.0


def wait_while(daemon: Remote, mode: str, why: str) -> dict[str, object]:
    """Poll until the daemon leaves a mode, bounded by its own time limits, and return the status then."""
    with waiting(why):
        while (status := daemon.get("/api/status"))["mode"] == mode:
            time.sleep(_POLL_S)
    return dict(status)


def settle(daemon: Remote) -> None:
    """Wait while the only reason against arming is motion capture that has just started, at most 3 s."""
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
    """Enable the actuators and wait until the arm is armed.

    Refused with the reasons while anything is missing or wrong. Motion capture that has just started is given 3 s.

    \b
    Example:
      softarm arm
    """
    leaves("arming was not requested")
    settle(daemon)
    leaves(f"the daemon continues to arm; {daemon.command('disarm')} reverts that")
    daemon.post("/api/arm")
    status = wait_while(daemon, "arming", "waiting for drive and regulator")
    if status["mode"] != "armed":
        fail(f"not armed, mode {status['mode']}: {status.get('last_stop') or 'see ' + daemon.command('status')}")
    click.echo("armed")


@click.command()
@remote
def disarm(daemon: Remote) -> None:
    """Brake the cart, vent the muscle, hold until the arm is still (at most 10 s) and switch the drive off.

    \b
    Example:
      softarm disarm
    """
    leaves("the daemon keeps running and disarms once the arm is still")
    daemon.post("/api/disarm")
    click.echo(wait_while(daemon, "stopping", "holding the cart until the arm is still")["mode"])


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
    """Stop by software: brake, vent, and stay stopped until `softarm acknowledge`.

    The request uses the dedicated stop port, which other requests cannot delay, and the API if that port does not
    answer. It needs the network and the daemon; the button on the wall needs neither.

    \b
    Example:
      softarm stop
    """
    if not daemon.stop(stop_port):
        try:
            daemon.request("POST", "/api/stop", timeout_s=STOP_TIMEOUT_S)
        except Failure as error:
            fail(f"NOT confirmed: use the emergency-stop button; {error.message}")
    click.echo(f"stopped and latched; {daemon.command('acknowledge')} releases the latch")


@click.command()
@remote
def acknowledge(daemon: Remote) -> None:
    """Release a latched emergency stop once its cause is gone. The arm stays disarmed.

    \b
    Example:
      softarm acknowledge
    """
    daemon.post("/api/acknowledge")
    click.echo(daemon.get("/api/status")["mode"])
