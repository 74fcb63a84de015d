"""`softarm status`: print the daemon's newest snapshot."""

import time
from collections.abc import Iterator
from typing import Any

import click
from rich.console import Console
from rich.live import Live
from rich.text import Text

from softarm.cli.shared.client import Remote, remote
from softarm.cli.shared.console import clock, print_json
from softarm.schemas.policy import OBSERVATION

Json = dict[str, Any]
WATCH_S = 0.2  # interval of --watch


@click.command()
@click.option("--watch", is_flag=True, help="Keep showing it until Ctrl-C.")
@click.option("--json", "as_json", is_flag=True, help="Print the API's unchanged answer.")
@remote
def status(daemon: Remote, watch: bool, as_json: bool) -> None:
    """Show the state of the arm, active faults, and the reasons against arming.

    \b
    Examples:
      softarm status
      softarm status --watch
      softarm status --json
    """
    if watch and as_json:
        raise click.UsageError("--watch shows lines for a person, --json one answer for a script: omit one")
    if watch:
        with Live(console=Console(), auto_refresh=False) as live:
            while True:
                live.update(Text("\n".join(lines(daemon.get("/api/status")))), refresh=True)
                time.sleep(WATCH_S)
    elif as_json:
        print_json(daemon.get("/api/status"))
    else:
        click.echo("\n".join(lines(daemon.get("/api/status"))))


def lines(now: Json) -> Iterator[str]:
    """Yield the lines of a status, without the values that the daemon does not have yet."""
    if now["stalled"]:
        yield "the control loop has stopped: the values below are old; see the daemon's own output"
    estop = "" if now["estop"] == "clear" else f"; emergency stop {now['estop']}"
    yield f"mode      {now['mode']}{estop}"
    yield f"policy    {now['policy']}" + (f": {now['policy_fault']}" if now["policy_fault"] else "")
    if goal := goal_line(now):
        yield f"goal      {goal}"
    if observed := now["observed"]:
        seen = dict(zip((signal.name for signal in OBSERVATION), observed["values"], strict=True))
        yield f"tip       y {seen['tip_y']:+.3f} m, z {seen['tip_z']:.3f} m"
        yield f"cart      y {seen['cart_position']:+.3f} m, {seen['cart_velocity']:+.2f} m/s"
        yield f"pressure  {seen['pressure']:.1f} kPa"
    clamps = f" (limited by {', '.join(now['clamps'])})" if now["clamps"] else ""
    sent = now["sent"]
    yield f"sent      {sent['cart_velocity_m_s']:+.2f} m/s, {sent['pressure_kpa']:.1f} kPa{clamps}"
    yield f"loop      tick {now['tick']}, {now['missed_total']} missed, {now['late_ns'] / 1e6:.1f} ms late"
    refusals = now["arming_refusals"]
    # A refusal includes the texts of its event and of the device; print each text once.
    printed = "".join(refusals)
    for device, problem in now["problems"].items():
        if problem and problem not in printed:
            yield f"{device:<9} {problem}"
    for event in now["events"]:
        if event["text"] not in printed:
            yield f"event     {event['name']} ({event['response']}): {event['text']}"
    for reason in refusals:
        yield f"cannot arm: {reason}"
    if now["last_stop"]:
        at = now["last_stop_at"]
        yield f"last stop: {now['last_stop']}" + (f" ({clock(at)})" if at else "")
    if now["recorder"]["log"]:
        yield f"log       {now['recorder']['log']}"


def goal_line(now: Json) -> str:
    """Return the state of the goal in a status as one line; empty without a goal."""
    status = now["goal"]
    goal = status["goal"]
    if not goal:
        return ""
    target = f" y {goal['y_m']:g}, z {goal['z_m']:g} m" if goal["kind"] == "reach" else ""
    closest = "" if status["closest_m"] is None else f", closest {status['closest_m']:.3f} m"
    reason = f" ({status['reason']})" if status["reason"] else ""
    return f"{goal['kind']}{target}: {status['state']}{reason}, {status['time_s']:.1f} s{closest}"
