"""Compare the independent robot with the simulator: their distance, and the flights of a policy on each.

    python -m validation.reality --policy reach

Both flights run the daemon's tick at 30 Hz in lockstep; only the devices differ. Needs the extra `mujoco`.
"""

from collections.abc import Callable

import click
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from benchmarks import commands
from softarm.common.processes import bar
from softarm.evaluation.evaluation import FLIGHTS
from softarm.evaluation.robots import ROBOTS
from softarm.evaluation.runner import Runner
from softarm.policies import registry
from softarm.policies.base import PolicyError
from softarm.reality.parameters import Arm, RobotParameters
from softarm.reality.robot import Robot
from softarm.schemas import flights
from softarm.schemas.flights import Shares
from softarm.schemas.robot import CONTROL_PERIOD_S, PHYSICS_RATE_HZ
from softarm.simulator.simulator import Simulator

CART_SHARE = 0.3  # share of the random velocity, which keeps the cart off the stops


def fly_targets(name: str, parameters: RobotParameters, advance: Callable[[], None]) -> Shares:
    """Fly the 54 targets from three cart starts."""
    runner, scenarios, reached = Runner(registry.load(name), parameters), flights.grid(), []
    for scenario in scenarios:
        reached.append(runner.fly(scenario).reached)
        advance()
    return flights.shares(reached, flights.heights(scenarios))


def agreement_mm(draw: Callable[..., tuple[NDArray[np.float64], NDArray[np.float64]]], pieces: int, sets: int) -> float:
    """Return the RMS distance of the tips in mm over 3 s of equal random commands."""
    apart = []
    for seed in range(sets):
        velocity, pressure = draw(1, seed=seed)
        simulator, robot = Simulator(physics_rate_hz=PHYSICS_RATE_HZ), Robot(RobotParameters(arm=Arm(pieces=pieces)))
        for tick, (v, p) in enumerate(zip(CART_SHARE * velocity[:, 0], pressure[:, 0], strict=True)):
            simulator.step(float(v), float(p), CONTROL_PERIOD_S)
            robot.command(tick * CONTROL_PERIOD_S, float(v), float(p))
            robot.advance((tick + 1) * CONTROL_PERIOD_S)
            apart.append(robot.truth.link_ends_m[-1] - simulator.tip_m()[0])
    return float(1e3 * np.sqrt(np.square(apart).sum(axis=1).mean()))


@click.command()
@click.option("--policy", default="reach", show_default=True, help="Name, as `softarm policy list` shows it.")
@click.option("--changed", type=click.Choice(list(ROBOTS)), default="nominal", help="How this robot differs.")
@click.option("--sets", default=32, show_default=True, type=click.IntRange(1), help="Random command sets.")
def main(policy: str, changed: str, sets: int) -> None:
    """Print both comparisons of the two robots.

    \b
    Example:
      python -m validation.reality --policy reach
    """
    console = Console()
    table = Table("commands", "links", "tip RMS over 3 s")
    try:
        with bar("independent robot", 4 + FLIGHTS) as shown:
            for draw in (commands.smooth, commands.bang_bang):
                for pieces in (1, 2):
                    apart_mm = agreement_mm(draw, pieces, sets)
                    table.add_row(draw.__name__, str(5 * pieces), f"{apart_mm:.1f} mm")
                    shown.advance()
            shares = fly_targets(policy, ROBOTS[changed], shown.advance)
    except PolicyError as error:
        raise click.ClickException(str(error)) from None
    console.print(table)
    low, above, both = (f"{100 * share:.1f} %" for share in shares)
    console.print(
        f"{policy}, robot {changed}, 54 targets x 3 cart starts: z <= 0.70 m {low}, above {above}, all {both}"
    )


if __name__ == "__main__":
    main()
