"""Measure how well and how fast a policy plans for new goals in mid-swing in real time.

    python -m benchmarks.replanning --json FILE

The daemon's tick runs in lockstep with the simulated robot and waits for the time of each tick, so that caches and
clock rates are those of a process that wakes 30 times a second. `softarm evaluate` flies the 54 targets.
"""

import random
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click
from rich.console import Console

from benchmarks import results
from softarm.common.processes import bar
from softarm.daemon.control.records import Mode
from softarm.daemon.runtime.offline import Lockstep
from softarm.policies import registry
from softarm.policies.base import Array, Policy, PolicyError
from softarm.schemas.config import Config
from softarm.schemas.flights import TEST_TARGETS
from softarm.schemas.robot import CONTROL_PERIOD_S

PATIENCE_TICKS = (6, 20)  # a goal is replaced in mid-swing after this many ticks
EASY_Z_MAX_M = 0.65  # highest goal within reach of the rail


@dataclass
class Timed:
    """Policy with the time of each step: wall time and processor time of its thread, ms."""

    policy: Policy
    wall_ms: list[float] = field(default_factory=list)
    processor_ms: list[float] = field(default_factory=list)
    cut_short: int = 0  # steps with fewer rounds than the longest one

    def __post_init__(self) -> None:
        """Take over the policy's spec."""
        self.spec = self.policy.spec
        self._most_rounds = 0

    def reset(self) -> None:
        """Reset the policy for a new goal."""
        self.policy.reset()

    def step(self, observation: Array, goal: Array) -> Array:
        """Run one timed step of the policy."""
        wall, processor = time.perf_counter(), time.thread_time()
        action = self.policy.step(observation, goal)
        self.wall_ms.append(1e3 * (time.perf_counter() - wall))
        self.processor_ms.append(1e3 * (time.thread_time() - processor))
        rounds = getattr(self.policy, "rounds_flown", 0)
        self._most_rounds = max(self._most_rounds, rounds)
        self.cut_short += rounds < self._most_rounds
        return action

    def figures(self) -> dict[str, Any]:
        """Return percentiles of both times and the number of steps."""
        return {
            "wall_ms": results.spread(self.wall_ms),
            "processor_ms": results.spread(self.processor_ms),
            "steps": len(self.wall_ms),
            "cut_short": self.cut_short,
        }


def fly_paced(policy: Policy, seconds: float, advance: Callable[[], None]) -> dict[str, Any]:
    """Fly in real time; every other goal is replaced in mid-swing and the next one is completed and counted.

    Raises:
        RuntimeError: The daemon has stopped the arm.
    """
    timed, draws = Timed(policy), random.Random(0)
    daemon = Lockstep(Config(), timed)
    outputs = daemon.arm()
    goals = [goal for goal in TEST_TARGETS if goal.z_m <= EASY_Z_MAX_M]
    reached: list[bool] = []
    patience: int | None = None  # ticks until the goal is replaced; None: it is completed
    deadline = time.perf_counter()
    for _ in range(round(seconds / CONTROL_PERIOD_S)):
        deadline += CONTROL_PERIOD_S
        time.sleep(max(0.0, deadline - time.perf_counter()))
        if outputs.goal.state == "running" and patience != 0:
            outputs = daemon.tick()
            patience = None if patience is None else patience - 1
        else:
            patience = draws.randint(*PATIENCE_TICKS) if patience is None else None
            outputs = daemon.tick(daemon.request("goal", draws.choice(goals)))
        if outputs.mode is not Mode.ARMED:
            raise RuntimeError(f"the daemon stopped the arm: {outputs.last_stop}")
        if patience is None and outputs.goal.state != "running":
            reached.append(outputs.goal.state == "reached")
        advance()
    return {"reached": sum(reached), "goals": len(reached), "planning": timed.figures()}


@click.command()
@click.option("--policy", "name", default="mppi", show_default=True, help="Name, as `softarm policy list` shows it.")
@click.option("--seconds", default=60.0, show_default=True, type=click.FloatRange(5.0), help="Duration of the flight.")
@results.json_option
def main(name: str, seconds: float, json_file: Path | None) -> None:
    """Print reached goals and planning times.

    \b
    Example:
      python -m benchmarks.replanning --policy mppi --seconds 60 --json replanning.json
    """
    console = Console()
    try:
        policy = registry.load(name)
    except PolicyError as error:
        raise click.ClickException(str(error)) from None
    with bar(name, round(seconds / CONTROL_PERIOD_S)) as shown:
        paced = fly_paced(policy, seconds, shown.advance)
    planning = paced["planning"]
    console.print(f"{name}, new goals in mid-swing: {paced['reached']} of {paced['goals']} reached")
    for key, label in (("wall_ms", "wall time"), ("processor_ms", "processor time")):
        console.print(
            "planning, {} time: p50 {p50:.1f}, p99 {p99:.1f}, max {max:.1f} ms".format(label, **planning[key])
        )
    console.print(f"{planning['steps']} steps, {planning['cut_short']} of them cut short")
    if json_file is not None:
        results.write(json_file, {"policy": name, "paced": paced})


if __name__ == "__main__":
    main()
