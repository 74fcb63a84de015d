"""The independent robot beside the simulator: how near it is, and how a policy flies on it.

    python -m benchmarks.reality --policy reach

Both flights are the daemon's own tick at 30 Hz in lockstep; only the devices differ. Needs the extra `mujoco`.
"""

from collections.abc import Callable
from dataclasses import replace

import click
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from benchmarks import commands
from daemon.evaluation import CART_STARTS_M, LIMIT_M
from daemon.records import Inputs, Mode, Outputs, Request
from daemon.tick import Controller
from policies import registry
from policies.base import Policy, PolicyError
from policies.runner import InlineRunner
from reality.parameters import Arm, Parameters
from reality.robot import Robot
from schemas.config import Config
from schemas.goals import TEST_TARGETS, TRAINED_Z_MAX_M, Goal
from schemas.messages import PressureReading, RailReading
from simulator.simulator import Simulator

ARMING_TICKS = 60
CART_SHARE = 0.3  # of the random commands' velocity, so that the cart stays off the stops


class Flight:
    """The daemon's controller on one independent robot, for one goal."""

    def __init__(self, policy: Policy, robot: Robot) -> None:
        config = Config()
        self.robot = robot
        self.farthest_cart_m = 0.0
        self._controller = Controller(config, InlineRunner(policy))
        self._rate_hz = config.control.rate_hz
        self._ticks = 0
        self._pressure: PressureReading | None = None
        self._rail: RailReading | None = None
        self._armed = False

    def reach(self, goal: Goal) -> bool:
        """Arm, take up the goal, fly to its end; True when it was reached within the rail's limit."""
        for _ in range(ARMING_TICKS):
            outputs = self._tick()
        outputs = self._tick(Request(1, "arm"))
        while outputs.mode is not Mode.ARMED:
            if self._ticks > 3 * ARMING_TICKS:
                raise RuntimeError(f"did not arm: {outputs.results}")
            outputs = self._tick()
        self.farthest_cart_m = 0.0
        outputs = self._tick(Request(2, "goal", goal))
        while outputs.goal.state == "running":
            outputs = self._tick()
        return outputs.goal.state == "reached" and self.farthest_cart_m <= LIMIT_M

    def _tick(self, *requests: Request) -> Outputs:
        self._ticks += 1
        now_s = self._ticks / self._rate_hz
        self.robot.advance(now_s)
        for reading in self.robot.pressure():
            self._pressure = replace(reading, armed=self._armed)
        for position in self.robot.rail():
            self._rail = replace(position, enabled=self._armed)
        frames = tuple(self.robot.mocap())
        outputs = self._controller.tick(
            Inputs(round(now_s * 1e9), mocap=frames, pressure=self._pressure, rail=self._rail, requests=requests)
        )
        self.farthest_cart_m = max(self.farthest_cart_m, abs(self.robot.truth.cart_position_m))
        sent, self._armed = outputs.sent, outputs.sent.enable
        velocity, pressure = (sent.cart_velocity_m_s, sent.pressure_kpa) if sent.enable else (0.0, 0.0)
        self.robot.command(now_s, velocity, pressure)
        return outputs


def fly_targets(name: str, parameters: Parameters, advance: Callable[[], None]) -> dict[str, NDArray[np.bool_]]:
    """Reached or not, [54 x 3], and whether the target is in the trained range."""
    policy = registry.load(name)
    reached, inside = [], []
    for number, goal in enumerate(TEST_TARGETS):
        for start_m in CART_STARTS_M:
            robot = Robot(parameters, number, cart_position_m=start_m, hanging=True)
            reached.append(Flight(policy, robot).reach(goal))
            inside.append(goal.z_m <= TRAINED_Z_MAX_M)
            advance()
    return {"reached": np.array(reached), "inside": np.array(inside)}


def agreement_mm(draw: Callable[..., tuple[NDArray[np.float64], NDArray[np.float64]]], pieces: int, sets: int) -> float:
    """RMS distance of the tips over 3 s of the same random commands, simulator against nominal independent robot."""
    apart = []
    for seed in range(sets):
        velocity, pressure = draw(1, seed=seed)
        simulator, robot = Simulator(physics_rate_hz=1200.0), Robot(Parameters(arm=Arm(pieces=pieces)))
        for tick, (v, p) in enumerate(zip(CART_SHARE * velocity[:, 0], pressure[:, 0], strict=True)):
            simulator.step(float(v), float(p), commands.PERIOD_S)
            robot.command(tick * commands.PERIOD_S, float(v), float(p))
            robot.advance((tick + 1) * commands.PERIOD_S)
            apart.append(robot.truth.link_ends_m[-1] - simulator.tip_m()[0])
    return float(1e3 * np.sqrt(np.square(apart).sum(axis=1).mean()))


@click.command()
@click.option("--policy", default="reach", show_default=True, help="Name, as `softarm policy list` shows it.")
@click.option("--sets", default=32, show_default=True, type=click.IntRange(1), help="Random command sets.")
def main(policy: str, sets: int) -> None:
    """Print both comparisons."""
    console = Console()
    table = Table("commands", "links", "tip RMS over 3 s")
    try:
        with Progress(console=console, transient=True) as progress:
            task = progress.add_task("independent robot", total=4 + len(TEST_TARGETS) * len(CART_STARTS_M))
            for draw in (commands.smooth, commands.bang_bang):
                for pieces in (1, 2):
                    apart_mm = agreement_mm(draw, pieces, sets)
                    table.add_row(draw.__name__, str(5 * pieces), f"{apart_mm:.1f} mm")
                    progress.advance(task)
            flown = fly_targets(policy, Parameters(), lambda: progress.advance(task))
    except PolicyError as error:
        raise click.ClickException(str(error)) from None
    console.print(table)
    reached, inside = flown["reached"], flown["inside"]
    shares = (100 * reached[chosen].mean() for chosen in (inside, ~inside, inside | ~inside))
    console.print(
        "{}, 54 targets x 3 cart starts: z <= 0.70 m {:.1f} %, above {:.1f} %, all {:.1f} %".format(policy, *shares)
    )


if __name__ == "__main__":
    main()
