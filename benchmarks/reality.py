"""The independent robot beside the simulator: how near it is, and how a policy flies on it.

    python -m softarm.benchmarks.reality --policy reach

Both flights are the daemon's own tick at 30 Hz in lockstep; only the devices differ. Needs the extra `mujoco`.
"""

from collections.abc import Callable

import click
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from softarm.benchmarks import commands
from softarm.flights import runner as trials
from softarm.flights.evaluation import FLIGHTS
from softarm.flights.robots import ROBOTS
from softarm.policies import registry
from softarm.policies.base import PolicyError
from softarm.reality.parameters import Arm, RobotParameters
from softarm.reality.robot import Robot
from softarm.schemas.goals import TRAINED_Z_MAX_M
from softarm.schemas.robot import CONTROL_PERIOD_S, PHYSICS_RATE_HZ
from softarm.simulator.simulator import Simulator

CART_SHARE = 0.3  # of the random commands' velocity, so that the cart stays off the stops


def fly_targets(name: str, parameters: RobotParameters, advance: Callable[[], None]) -> dict[str, NDArray[np.bool_]]:
    """Reached or not, and whether the target is in the trained range, of each trial of the grid."""
    policy, reached, inside = registry.load(name), [], []
    for trial in trials.grid_trials():
        (outcome,) = trials.fly_held_back(policy, parameters, [trial])
        reached.append(outcome.reached)
        inside.append(trial.goal.z_m <= TRAINED_Z_MAX_M)
        advance()
    return {"reached": np.array(reached), "inside": np.array(inside)}


def agreement_mm(draw: Callable[..., tuple[NDArray[np.float64], NDArray[np.float64]]], pieces: int, sets: int) -> float:
    """RMS distance of the tips over 3 s of the same random commands, simulator against nominal independent robot."""
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
    """Print both comparisons.

    \b
    Example:
      python -m softarm.benchmarks.reality --policy reach
    """
    console = Console()
    table = Table("commands", "links", "tip RMS over 3 s")
    try:
        with Progress(console=console, transient=True) as progress:
            task = progress.add_task("independent robot", total=4 + FLIGHTS)
            for draw in (commands.smooth, commands.bang_bang):
                for pieces in (1, 2):
                    apart_mm = agreement_mm(draw, pieces, sets)
                    table.add_row(draw.__name__, str(5 * pieces), f"{apart_mm:.1f} mm")
                    progress.advance(task)
            flown = fly_targets(policy, ROBOTS[changed], lambda: progress.advance(task))
    except PolicyError as error:
        raise click.ClickException(str(error)) from None
    console.print(table)
    reached, inside = flown["reached"], flown["inside"]
    shares = (100 * reached[chosen].mean() for chosen in (inside, ~inside, inside | ~inside))
    console.print(
        "{}, robot {}, 54 targets x 3 cart starts: z <= 0.70 m {:.1f} %, above {:.1f} %, all {:.1f} %".format(
            policy, changed, *shares
        )
    )


if __name__ == "__main__":
    main()
