"""`softarm goal`: set, show or cancel the goal of the arm."""

import time
from typing import Any

import click

from softarm.cli.operate.status import goal_line
from softarm.cli.shared.client import Remote, remote
from softarm.cli.shared.completion import targets
from softarm.cli.shared.console import NUMBER, Number, print_json, print_option, typed, waiting
from softarm.cli.shared.errors import fail, leaves

wait_option = click.option("--wait", is_flag=True, help="Wait for the end; exit code 1 if it is not reached.")


@click.group(invoke_without_command=True)
@click.pass_context
@remote
def goal(daemon: Remote, context: click.Context) -> None:
    """Reach for a target, run a policy, hold, or cancel. The arm must be armed.

    Without a verb it shows the state of the newest goal.

    \b
    Examples:
      softarm goal
      softarm goal reach -0.2 0.6 --wait
      softarm goal run
      softarm goal hold
      softarm goal cancel
    """
    if context.invoked_subcommand is None:
        nothing = "no goal since the daemon started; `softarm goal --help` lists the verbs"
        click.echo(goal_line(daemon.get("/api/status")) or nothing)
    elif options := typed():
        raise click.UsageError(f"{options[0]} goes after the verb: `softarm goal {context.invoked_subcommand} ...`")


# A negative coordinate is not an option.
@goal.command(context_settings={"ignore_unknown_options": True})
@click.argument("y", type=NUMBER, shell_complete=targets)
@click.argument("z", type=NUMBER, shell_complete=targets)
@wait_option
@print_option
@remote
def reach(daemon: Remote, y: float, z: float, wait: bool, as_json: bool) -> None:
    """Swing the tip to Y (along the rail) and Z (up), in metres.

    \b
    Examples:
      softarm goal reach -0.2 0.6
      softarm goal reach -0.35 0.65 --wait
      softarm goal reach -0.2 0.6 --wait --json
    """
    answer = _give(daemon, {"kind": "reach", "y_m": y, "z_m": z})
    follow(daemon, answer, f"reaching for y {y:g}, z {z:g} m", wait, as_json)


@goal.command()
@click.option("--seconds", type=Number(0, min_open=True), help="Cancel it after this time.")
@wait_option
@print_option
@remote
def run(daemon: Remote, seconds: float | None, wait: bool, as_json: bool) -> None:
    """Run the active policy without a target, for policies that need none.

    The goal ends with the policy's own episode. A policy without an end runs until another goal, `softarm goal cancel`
    or --seconds.

    \b
    Examples:
      softarm goal run
      softarm goal run --wait
      softarm goal run --seconds 10
    """
    answer = _give(daemon, {"kind": "run"})
    lasting = "" if seconds is None else f" for {seconds:g} s"
    follow(daemon, answer, f"running {answer['policy']}{lasting}", wait, as_json, seconds)


@goal.command()
@remote
def hold(daemon: Remote) -> None:
    """Brake the cart and vent the muscle; the arm stays armed.

    \b
    Example:
      softarm goal hold
    """
    _give(daemon, {"kind": "hold"})
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


def _give(daemon: Remote, body: dict[str, object]) -> dict[str, Any]:
    """Set the goal, print its warnings to standard error and return the answer."""
    answer = daemon.post("/api/goal", body)
    for warning in answer["warnings"]:
        click.echo(f"warning: {warning}", err=True)
    return dict(answer)


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
