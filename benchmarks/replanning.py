"""Time that `mppi` needs for a command, and its success: from rest, from mid-swing and into the shelf.

    python -m benchmarks.replanning --json FILE

The policy thinks with its real budget. While it does, the program has the daemon's real-time priority, if the system
grants it, so that the wall time holds beside other work.
"""

import time
from pathlib import Path
from typing import Any

import click

from benchmarks import results
from softarm.common import realtime
from softarm.evaluation.runner import Runner
from softarm.policies.base import Array
from softarm.policies.mppi.policy import Mppi
from softarm.schemas import flights
from softarm.schemas.flights import SHELF_MIDDLE_M, Scenario
from softarm.schemas.robot import CONTROL_PERIOD_S


class Timed(Mppi):
    """Policy that measures wall and processor time of its steps, ms, and counts its rounds."""

    def __init__(self, target_depth_m: float | None = None) -> None:
        self.steps: list[tuple[float, float, int]] = []
        super().__init__(target_depth_m=target_depth_m)

    def step(self, observation: Array, goal: Array) -> Array:
        """Return the command of the policy, measured."""
        wall, cpu = time.perf_counter_ns(), time.thread_time_ns()
        command = super().step(observation, goal)
        cpu, wall = time.thread_time_ns() - cpu, time.perf_counter_ns() - wall
        self.steps.append((wall / 1e6, cpu / 1e6, self.rounds_flown))
        # A real loop waits here; without a pause, the system takes the priority away after 0.95 s of every second.
        time.sleep(0.1 * CONTROL_PERIOD_S)
        return command


def measure(scenarios: list[Scenario], target_depth_m: float | None = None) -> dict[str, Any]:
    """Fly scenarios and return the spread of wall and processor time in ms, the mean of rounds and the successes."""
    policy = Timed(target_depth_m=target_depth_m)
    runner = Runner(policy)
    runner.fly(scenarios[0])
    policy.steps.clear()
    reached = [runner.fly(scenario).status.state == "reached" for scenario in scenarios]
    wall, cpu, rounds = zip(*policy.steps, strict=True)
    spreads = {"wall_ms": results.spread(wall), "cpu_ms": results.spread(cpu)}
    return {"flights": len(reached), "reached": sum(reached), "rounds": sum(rounds) / len(rounds), **spreads}


@click.command()
@click.option("--every", type=click.IntRange(1), default=1, show_default=True, help="Fly every Nth scenario only.")
@results.json_option
def main(every: int, json_file: Path | None) -> None:
    """Fly the 54 targets from rest, from mid-swing and the shelf, and print p50 / p99 and successes.

    \b
    Example:
      python -m benchmarks.replanning --every 9
    """
    Timed()  # compiles at ordinary priority
    refused = realtime.ask(realtime.BASE_PRIORITY)
    priority = "real-time" if refused is None else f"ordinary ({refused.strerror})"
    tests = {"rest": (flights.grid(), None), "mid-swing": (flights.swinging(), None)}
    shelved = {"shelf": (flights.shelf(), SHELF_MIDDLE_M), "shelf, random": (flights.random_shelf(), SHELF_MIDDLE_M)}
    figures = {name: measure(cases[::every], depth_m) for name, (cases, depth_m) in (tests | shelved).items()}
    results.write(json_file, {"priority": priority, "tests": figures})
    click.echo(f"priority: {priority}")
    for name, row in figures.items():
        times = (f"{kind} {row[kind]['p50']:.1f} / {row[kind]['p99']:.1f}" for kind in ("wall_ms", "cpu_ms"))
        click.echo(f"{name}: {row['reached']} of {row['flights']}, {', '.join(times)}, {row['rounds']:.2f} rounds")


if __name__ == "__main__":
    main()
