"""`softarm evaluate`: a policy at the paper's 54 targets, or all policies at all tests, by the daemon's own tick."""

import shlex
import sys
from pathlib import Path

import click

from softarm.cli.completion import policies
from softarm.cli.errors import fail
from softarm.cli.interrupt import NOTHING, leaves
from softarm.cli.options import FILE, config_option, flown_model, json_option, model_option, write, write_json
from softarm.cli.printing import print_table
from softarm.common.processes import WorkerDied, bar, cores


@click.command()
@click.option("--policy", default="reach", show_default=True, shell_complete=policies, help="Of `softarm policy list`.")
@json_option
@config_option
@model_option
@click.option("--all", "compare_all", is_flag=True, help="All policies at all tests, the shelf and other robots too.")
@click.option("--report", type=FILE, help="With --all: write the table as one HTML file.")
@click.option(
    "--runs",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    help="With --all: a sweep's folder; its policies stand for the shipped ones, with the spread over seeds.",
)
@click.option("--only", multiple=True, metavar="NAME", help="With --all: this policy or `ceiling` alone; or more.")
@click.option("--test", "tests", multiple=True, help="With --all: this test alone, TEST or TEST@MODEL; again for more.")
@click.option("--matrix", is_flag=True, help="With --runs: the sweep alone, on every shipped model and beyond.")
@click.option("--workers", type=click.IntRange(min=1), help="With --all: processes.  [default: one a core]")
def evaluate(
    policy: str,
    json_file: Path | None,
    config_file: Path | None,
    model_file: Path | None,
    compare_all: bool,
    report: Path | None,
    runs: Path | None,
    only: tuple[str, ...],
    tests: tuple[str, ...],
    matrix: bool,
    workers: int | None,
) -> None:
    """Fly the 54 test targets from rest at cart positions 0, 0.1 and 0.2 m, in lockstep at 1200 Hz.

    Observer, policy, safety filter and failsafe are the daemon's own; only the devices are simulated. With --all
    every policy flies them also from mid-swing and on the independent robot, and swings into the shelf; beside them
    the ceiling, what a search over open-loop commands reaches.

    \b
    Examples:
      softarm evaluate --policy reach --json reach.json
      softarm evaluate --policy pid
      softarm evaluate --all --json all.json --report all.html
      softarm evaluate --all --runs runs/compare --only reach --test grid --test held_back
    """
    leaves(NOTHING)
    if compare_all or matrix:
        _compare(json_file, report, runs, only, tests, matrix, workers)
        return
    if report or runs or only or tests:
        raise click.UsageError("--report, --runs, --only and --test go with --all")
    _evaluate(policy, json_file, config_file, model_file)


def _compare(
    json_file: Path | None,
    report: Path | None,
    runs: Path | None,
    only: tuple[str, ...],
    tests: tuple[str, ...],
    matrix: bool,
    workers: int | None,
) -> None:
    from softarm.flights import page, table
    from softarm.flights import tests as known
    from softarm.policies.base import PolicyError
    from softarm.simulator.model_file import ModelFileError

    if matrix and runs is None:
        raise click.UsageError("--matrix is about a sweep: give its folder with --runs")
    tests = tests or (known.MATRIX if matrix else tuple(known.TESTS))
    try:
        for test in tests:
            known.check(test)
        found = table.entries(runs, only, only_runs=matrix)
        with bar("flying", sum(len(job.part) for job in table.jobs(found, tests))) as shown:
            result = table.compare(found, workers or cores(), tests, shown.advance)
    except (PolicyError, ModelFileError, ValueError, WorkerDied) as error:
        fail(str(error))
    click.echo(page.markdown(result), nl=False)
    write_json(json_file, result)
    if report is not None:
        write(report, page.html(result, shlex.join(["softarm", *sys.argv[1:]])))


def _evaluate(policy: str, json_file: Path | None, config_file: Path | None, model_file: Path | None) -> None:
    from softarm.daemon.config import configuration
    from softarm.flights import evaluation
    from softarm.policies.base import PolicyError
    from softarm.schemas.config import Config

    try:
        config = configuration.load(config_file) if config_file else Config()
        model = flown_model(model_file)
        with bar(f"flying {policy}", evaluation.FLIGHTS) as shown:
            result = evaluation.evaluate(policy, config, model, shown.advance)
    except (configuration.ConfigurationError, PolicyError) as error:
        fail(str(error))
    parts = (("z <= 0.70 m", "in_range"), ("z > 0.70 m", "above"), ("all", "all"))
    rows = [(label, f"{100 * result['success'][part]:.1f} %") for label, part in parts]
    print_table(("targets", "reached"), rows, f"{policy}: 54 targets x 3 cart starts")
    click.echo(
        f"highest tip {result['max_tip_z_m']:.3f} m, farthest cart {result['max_cart_m']:.3f} m, "
        f"{result['real_time_factor']:.0f}x real time"
    )
    write_json(json_file, result)
