"""`softarm demo`: a robot that is not there, swung by the real daemon over real wires."""

import random
import sys
import time
from pathlib import Path
from typing import Any

import click

from softarm.cli.options import model_option
from softarm.schemas.goals import TEST_TARGETS, Goal

SETTLED_M_S = 0.05  # tip speed
SETTLE_MIN_S, SETTLE_MAX_S = 0.5, 6.0
NEEDED = 0.8  # share of the targets


@click.command()
@click.option("--targets", default=10, show_default=True, type=click.IntRange(1, 54), help="How many of the 54.")
@click.option("--seed", default=0, show_default=True, help="Which ones: a random draw.")
@click.option("--policy", default="reach-wide", show_default=True, help="Who flies.")
@model_option
@click.option("--logs", default="logs", show_default=True, type=click.Path(path_type=Path), help="For the MCAP log.")
def demo(targets: int, seed: int, policy: str, model_file: Path | None, logs: Path) -> None:
    """Start a twin robot and the daemon as two processes and swing the tip onto targets given over REST.

    The daemon reads motion capture from Zenoh, runs the policy, and drives the regulator over a serial line and
    the rail over TCP. Only the robot behind the wires is simulated. Ends with 0 when at least 80 % of the targets
    were reached and no limit was exceeded.

    \b
    Examples:
      softarm demo
      softarm demo --targets 54 --seed 1
      softarm demo --model no-pressure-lag
    """
    from rich.console import Console

    from softarm.cli.rig import Rig, RigError

    console = Console()
    goals = random.Random(seed).sample(TEST_TARGETS, targets)
    try:
        console.print("starting the twin (the robot behind its wires) and the daemon ...")
        with Rig(logs, {"control": {"policy": policy}}, model_file) as rig:
            path = rig.status()["recorder"]["log"]
            console.print(f"daemon at {rig.url} (API: {rig.url}/docs), policy {policy}")
            rig.arm()
            console.print(f"armed; {targets} targets, one after another, from wherever the last one ended\n")
            results = [fly(console, rig, number, goal) for number, goal in enumerate(goals, 1)]
            rig.post("disarm")
        problems = exceeded(Path(path))
    except RigError as error:
        console.print(f"[red]{error}[/red]")
        sys.exit(1)
    show(console, results)
    console.print(f"log: {path}")
    reached = sum(result["state"] == "reached" for result in results)
    if reached < NEEDED * targets:
        problems.append(f"{reached} of {targets} targets were reached, fewer than {NEEDED:.0%}")
    for problem in problems:
        console.print(f"[red]{problem}[/red]")
    if problems:
        sys.exit(1)
    console.print(f"[green]{reached} of {targets} reached, no limit exceeded[/green]")


def fly(console: Any, rig: Any, number: int, goal: Goal) -> dict[str, Any]:
    """One target: settle, post the goal, follow it on one line."""
    settle(rig)
    rig.reach(goal)
    label = f"{number:2d}  target ({goal.y_m:+.2f}, {goal.z_m:.2f}) m"
    with console.status(label) as line:
        while (result := rig.client.get("/api/goal").json())["state"] == "running":
            _, _, tip_y, tip_z, *_ = rig.status()["observed"]["values"]
            line.update(f"{label}   tip ({tip_y:+.2f}, {tip_z:.2f}) m")
            time.sleep(0.05)
    mark = "[green]reached[/green]" if result["state"] == "reached" else f"[red]{result['state']}[/red]"
    console.print(f"{label}   {mark} after {result['time_s']:.2f} s, closest {1e3 * result['closest_m']:.0f} mm")
    return dict(result)


def settle(rig: Any) -> None:
    """A hold until the arm hangs nearly still."""
    started = time.monotonic()
    while (passed := time.monotonic() - started) < SETTLE_MAX_S:
        *_, speed_y, speed_z, _, _ = rig.status()["observed"]["values"]
        if passed > SETTLE_MIN_S and max(abs(speed_y), abs(speed_z)) < SETTLED_M_S:
            return
        time.sleep(0.05)


def show(console: Any, results: list[dict[str, Any]]) -> None:
    """The table at the end."""
    from rich.table import Table

    table = Table("target y, z (m)", "result", "time (s)", "closest (mm)")
    for result in results:
        table.add_row(
            f"{result['y_m']:+.2f}, {result['z_m']:.2f}",
            result["state"],
            f"{result['time_s']:.2f}",
            f"{1e3 * result['closest_m']:.0f}",
        )
    console.print(table)


def exceeded(path: Path) -> list[str]:
    """What the log says of the limits: the cart as the axis read it, the commands as they were sent."""
    from softarm.daemon.logbook import logs

    log = logs.read(path)
    limits = log.config.limits
    problems = []
    carts = [i.rail.position_m for i in log.inputs() if i.rail is not None]
    low, high = limits.rail.position_min_m, limits.rail.position_max_m
    if min(carts) < low or max(carts) > high:
        problems.append(f"the cart left its limits: {min(carts):.3f} to {max(carts):.3f} m")
    sent = [outputs.sent for outputs in log.outputs()]
    if any(abs(command.cart_velocity_m_s) > limits.rail.velocity_max_m_s for command in sent):
        problems.append("a velocity above its limit was sent")
    if any(not limits.pressure.min_kpa <= c.pressure_kpa <= limits.pressure.max_kpa for c in sent):
        problems.append("a pressure outside its limits was sent")
    return problems
