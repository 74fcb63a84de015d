"""What a fault costs: policies over the 54 targets on the independent robot, one thing wrong with it at a time.

    python -m softarm.benchmarks.faults --policy reach --policy reach-robust --json faults.json --png faults.png

Every flight is the daemon's own tick in lockstep. A policy's ranges of randomisation, and what is worth a diagnosis,
follow from this table. Needs the extra `mujoco`.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table

from softarm.benchmarks import results
from softarm.common.processes import WorkerDied, bar
from softarm.flights.evaluation import FLIGHTS
from softarm.flights.many import fly_all, shares
from softarm.flights.robots import with_faults
from softarm.policies import registry
from softarm.policies.base import PolicyError
from softarm.reality.parameters import RobotParameters

NONE = "none"
MARKERS = "osD^vP*X"  # of matplotlib, one a policy
# Strong, within what the registry of effects and a bench allow; the rail's first.
FAULTS = (
    "rail.delay_s=0.06",
    "rail.delay_s=0.09",
    "rail.acceleration_m_s2=3",
    "rail.acceleration_m_s2=2",
    "rail.lag_s=0.1",
    "rail.force_limit_n=8",
    "rail.viscous_n_s_m=15",
    "regulator.dead_time_s=0.15",
    "regulator.flow_limit_kpa_s=40",
    "regulator.ceiling_kpa=12",
    "regulator.gain=-0.3",
    "arm.payload_kg=0.12",
    "arm.muscle_gain=-0.35",
    "arm.saturation_kpa=10",
    "arm.stiffness=0.5",
    "arm.stiffness=-0.35",
    "arm.damping=2",
    "arm.torque_offset=2",
)


def measure(policies: Sequence[str], faults: Sequence[str], tell: Callable[[int], None]) -> dict[str, dict[str, float]]:
    """Return fault -> policy -> share of the 162 flights that reached their target.

    tell(how many more are done). Raises PolicyError and, for a fault that there is none of, ValueError.
    """
    robots = {NONE: RobotParameters()} | {fault: with_faults(RobotParameters(), [fault]) for fault in faults}
    for policy in policies:
        registry.load(policy)  # before minutes of work
    flown = fly_all({policy: policy for policy in policies}, robots, on_flights=tell)
    return {fault: {policy: shares(flown[policy, fault]).all for policy in policies} for fault in robots}


def draw(found: dict[str, dict[str, float]], policies: Sequence[str], path: Path) -> None:
    """One line a fault, one dot a policy."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 0.32 * len(found) + 1.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    rows = range(len(found))
    for row, reached in zip(rows, found.values(), strict=True):
        axes.plot([100 * min(reached.values()), 100 * max(reached.values())], [row, row], color="0.8", lw=3, zorder=1)
    for number, policy in enumerate(policies):
        marker = MARKERS[number % len(MARKERS)]
        axes.scatter([100 * reached[policy] for reached in found.values()], rows, marker=marker, label=policy, zorder=2)
    axes.set_yticks(rows, ["no fault" if fault == NONE else fault for fault in found])
    axes.invert_yaxis()
    axes.set_xlim(0, 100)
    axes.set_xlabel("of 54 targets from three starts reached, %")
    axes.grid(axis="x", alpha=0.3)
    axes.legend(loc="lower left")
    figure.savefig(path, dpi=120)


@click.command()
@click.option(
    "--policy",
    "policies",
    multiple=True,
    default=("reach", "reach-wide", "reach-robust"),
    show_default=True,
    help="Name, as `softarm policy list` shows it; again for more.",
)
@click.option(
    "--fault", "faults", multiple=True, metavar="GROUP.QUANTITY=VALUE", help="This one alone; again for more."
)
@results.json_option
@click.option("--png", type=results.FILE, help="Draw the figures to this file.")
def main(policies: tuple[str, ...], faults: tuple[str, ...], json_file: Path | None, png: Path | None) -> None:
    """Print a row a fault, a column a policy.

    \b
    Example:
      python -m softarm.benchmarks.faults --policy reach --policy pid --json faults.json --png faults.png
    """
    console = Console()
    wanted = faults or FAULTS
    try:
        with bar("flying", (1 + len(wanted)) * len(policies) * FLIGHTS) as shown:
            found = measure(policies, wanted, shown.advance)
    except (PolicyError, ValueError, WorkerDied) as error:
        raise click.ClickException(str(error)) from None
    table = Table("fault", *policies)
    for fault, reached in found.items():
        table.add_row(fault, *(f"{reached[policy]:.1%}" for policy in policies))
    console.print(table)
    if json_file is not None:
        results.write(json_file, found)
    if png is not None:
        draw(found, policies, png)


if __name__ == "__main__":
    main()
