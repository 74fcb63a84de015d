"""Measure the cost of a fault: policies at the 54 targets on the independent robot, one fault at a time.

    python -m validation.faults --policy reach --policy reach-robust --json faults.json

Every flight runs the daemon's tick in lockstep. The table shows which faults policies should be trained for and which
are worth a diagnosis. Needs the extra `mujoco`.
"""

from collections.abc import Sequence
from pathlib import Path

import click

from benchmarks import results
from softarm.cli.shared.errors import failing
from softarm.common import batch
from softarm.common.batch import JobsFailed
from softarm.common.processes import WorkerDied
from softarm.evaluation.robots import with_faults
from softarm.evaluation.runner import fly, load
from softarm.policies import registry
from softarm.policies.base import PolicyError
from softarm.reality.parameters import RobotParameters
from softarm.schemas import flights

POLICIES = ("reach", "reach-wide", "reach-robust")
NAME_HELP = "Name as in `softarm policy list`; may be repeated."
# Strong faults within the bounds of the effect registry and of a bench; the rail's first.
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


def measure(policies: Sequence[str]) -> dict[str, dict[str, float]]:
    """Return fault -> policy -> share of the 162 flights that reached their target.

    Raises PolicyError if a policy cannot be loaded.
    """
    robots = {"none": RobotParameters()} | {fault: with_faults(RobotParameters(), [fault]) for fault in FAULTS}
    for policy in policies:
        registry.load(policy)  # fail before minutes of work
    todo = {f"{policy}, {fault}": (policy, robot) for fault, robot in robots.items() for policy in policies}
    found = batch.run("flying", _fly, todo).complete()
    return {fault: {policy: found[f"{policy}, {fault}"] for policy in policies} for fault in robots}


def _fly(job: tuple[str, RobotParameters]) -> float:
    policy, robot = job
    flown = fly(load(policy), robot, flights.grid())
    return sum(flight.reached for flight in flown) / len(flown)


@click.command()
@click.option("--policy", "policies", multiple=True, default=POLICIES, show_default=True, help=NAME_HELP)
@results.json_option
def main(policies: tuple[str, ...], json_file: Path | None) -> None:
    """Print a table with a row per fault and a column per policy.

    \b
    Example:
      python -m validation.faults --policy reach --policy pid --json faults.json
    """
    with failing(PolicyError, WorkerDied, JobsFailed):
        found = measure(policies)
    results.report("faults", found, json_file)


if __name__ == "__main__":
    main()
