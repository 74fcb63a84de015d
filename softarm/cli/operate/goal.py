"""`softarm goal`: set, show or cancel the goal of the arm."""

from typing import Any

import click

from softarm.cli.operate.following import follow
from softarm.cli.operate.status import goal_line
from softarm.cli.shared.client import Remote, remote
from softarm.cli.shared.completion import targets
from softarm.cli.shared.options import typed
from softarm.cli.shared.printing import print_option
from softarm.cli.verbs import Verbs

wait_option = click.option("--wait", is_flag=True, help="Wait for the end; exit code 1 if it is not reached.")


@click.group(cls=Verbs, invoke_without_command=True)
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
@click.argument("y", type=float, shell_complete=targets)
@click.argument("z", type=float, shell_complete=targets)
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
@click.option("--seconds", type=click.FloatRange(0, min_open=True), help="Cancel it after this time.")
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
    """Brake the cart and set the muscle to its rest pressure; the arm stays armed.

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
