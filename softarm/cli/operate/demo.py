"""`softarm demo`: the real daemon swings a simulated robot behind real interfaces."""

import contextlib
import random
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from softarm.cli.shared.completion import policies
from softarm.cli.shared.console import model_option, print_table, waiting
from softarm.cli.shared.errors import leaves
from softarm.schemas.flights import TEST_TARGETS
from softarm.schemas.goals import Goal

if TYPE_CHECKING:
    from rich.console import Console

    from softarm.evaluation.software_in_the_loop import SoftwareInTheLoop

NEEDED = 0.8  # share of the targets


@click.command()
@click.option("--targets", default=10, show_default=True, type=click.IntRange(1, 54), help="Number of targets.")
@click.option("--seed", default=0, show_default=True, help="Seed of the random choice among the 54 targets.")
@click.option("--policy", default="reach-wide", show_default=True, shell_complete=policies, help="Policy to fly.")
@model_option
@click.option("--logs", default="logs", show_default=True, type=click.Path(path_type=Path), help="For the MCAP log.")
def demo(targets: int, seed: int, policy: str, model_file: Path | None, logs: Path) -> None:
    """Start the twin and the daemon as two processes and swing the tip onto targets given over REST.

    The daemon reads motion capture from Zenoh, runs the policy, and drives the regulator over a serial line and
    the rail over TCP. Only the robot behind these interfaces is simulated. Exit code 0 means that at least 80 % of the
    targets were reached and no limit was exceeded.

    \b
    Examples:
      softarm demo
      softarm demo --targets 54 --seed 1
      softarm demo --model no-pressure-lag
    """
    from rich.console import Console

    from softarm.daemon.logbook.logs import exceeded, read
    from softarm.evaluation.software_in_the_loop import SoftwareInTheLoop

    leaves(f"twin and daemon have ended; the recording is in {logs}")
    console = Console()
    goals = random.Random(seed).sample(TEST_TARGETS, targets)
    with contextlib.ExitStack() as both:
        sil = SoftwareInTheLoop(logs, {"control": {"policy": policy}}, model_file)
        click.echo(f"watch it at {sil.url}, which answers in some seconds; policy {policy}")
        with waiting("starting the twin (the simulated robot) and the daemon; the very first start compiles"):
            both.enter_context(sil)
        path = sil.status()["recorder"]["log"]
        sil.arm()
        console.print(f"armed; {targets} targets, each from the position where the last one ended\n")
        results = [_fly(console, sil, number, goal) for number, goal in enumerate(goals, 1)]
        sil.post("disarm")
    log = read(path)
    problems = exceeded(log.ticks(), log.config.limits)
    rows = [
        (
            f"{result['y_m']:+.2f}, {result['z_m']:.2f}",
            result["state"],
            f"{result['time_s']:.2f}",
            in_mm(result["closest_m"]),
        )
        for result in results
    ]
    print_table(("target y, z (m)", "result", "time (s)", "closest (mm)"), rows)
    console.print(f"log: {path}")
    reached = sum(result["state"] == "reached" for result in results)
    if reached < NEEDED * targets:
        problems.append(f"{reached} of {targets} targets were reached, fewer than {NEEDED:.0%}")
    for problem in problems:
        console.print(f"[red]{problem}[/red]")
    if problems:
        sys.exit(1)
    console.print(f"[green]{reached} of {targets} reached, no limit exceeded[/green]")
    click.echo("next: `softarm run --simulated --open` flies to where you click")
    click.echo(f"or:   `softarm logs view {path}` plays this flight")


def _fly(console: "Console", sil: "SoftwareInTheLoop", number: int, goal: Goal) -> dict[str, Any]:
    """Fly to one target and report on one line."""
    label = f"{number:2d}  target ({goal.y_m:+.2f}, {goal.z_m:.2f}) m"
    with console.status(label) as line:
        result = sil.fly(goal, lambda y_m, z_m: line.update(f"{label}   tip ({y_m:+.2f}, {z_m:.2f}) m"))
    mark = "[green]reached[/green]" if result["state"] == "reached" else f"[red]{result['state']}[/red]"
    console.print(f"{label}   {mark} after {result['time_s']:.2f} s, closest {in_mm(result['closest_m'])} mm")
    return result


def in_mm(closest_m: float | None) -> str:
    """Return a closest distance in mm; a dash for a goal that a stop ended before its first tick."""
    return "-" if closest_m is None else f"{1e3 * closest_m:.1f}"
