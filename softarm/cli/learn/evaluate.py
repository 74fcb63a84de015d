"""`softarm evaluate`: how often policies reach their targets, flown by the real control loop."""

import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from softarm.cli.shared.completion import policies as known_policies
from softarm.cli.shared.errors import failing
from softarm.cli.shared.interrupt import NOTHING, leaves
from softarm.cli.shared.options import (
    FILE,
    config_option,
    flown_model,
    json_option,
    load_config,
    model_option,
    write,
    write_json,
)
from softarm.cli.shared.printing import print_table
from softarm.common.processes import bar, cores

DEFAULT_POLICY = "reach"


@dataclass(frozen=True)
class _Choice:
    """Options of one call, by their names in the command."""

    policies: tuple[str, ...]
    config_file: Path | None
    model_file: Path | None
    compare_all: bool
    runs: Path | None
    only: tuple[str, ...]
    tests: tuple[str, ...]
    matrix: bool

    @property
    def files(self) -> tuple[Path, ...]:
        """Policies that were given as ONNX files."""
        return tuple(Path(policy) for policy in self.policies if policy.endswith(".onnx"))

    def check(self) -> None:
        """Raise UsageError for options that have no effect together."""
        names = [policy for policy in self.policies if not policy.endswith(".onnx")]
        if self.compare_all and names:
            raise click.UsageError(
                f"--policy {names[0]}: --all flies every policy that has a name. Choose rows with --only, and give "
                "--policy FILE.onnx to add a file"
            )
        if (self.runs or self.only) and not (self.compare_all or self.matrix):
            raise click.UsageError("--runs and --only go with --all. Without --all, name each policy with --policy")
        if self.matrix and self.runs is None:
            raise click.UsageError("--matrix is about a sweep: give its folder with --runs")
        if self.matrix and (self.policies or self.model_file):
            raise click.UsageError(
                "--matrix flies a sweep's policies on every shipped model: omit --policy and --model"
            )
        if self.model_file and (own := [test for test in self.tests if "@" in test]):
            raise click.UsageError(f"--test {own[0]} names a model itself: omit --model, or @ and what follows")


@click.command()
@click.option(
    "--policy",
    "policies",
    multiple=True,
    metavar="NAME|FILE.onnx",
    shell_complete=known_policies,
    help="A policy of `softarm policy list`, or an ONNX file; repeat to compare several.  [default: reach]",
)
@json_option
@config_option
@model_option
@click.option("--all", "compare_all", is_flag=True, help="Compare all policies in all tests.")
@click.option("--report", type=FILE, help="Write the comparison as one HTML file.")
@click.option(
    "--runs",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    help="With --all: a sweep's folder; its policies replace shipped ones of the same name.",
)
@click.option("--only", multiple=True, metavar="NAME", help="With --all: only this policy, or `ceiling`; repeatable.")
@click.option("--test", "tests", multiple=True, help="Fly this test, TEST or TEST@MODEL; repeatable.")
@click.option("--matrix", is_flag=True, help="With --runs: fly the sweep alone, on every shipped model.")
@click.option("--workers", type=click.IntRange(min=1), help="Processes of a comparison.  [default: one per core]")
def evaluate(json_file: Path | None, report: Path | None, workers: int | None, **chosen: Any) -> None:
    """Fly the 54 test targets from rest at cart positions 0, 0.1 and 0.2 m, in lockstep at 1200 Hz.

    Observer, policy, safety filter and failsafe are those of the daemon; only the devices are simulated. Several
    policies, --test or --report give a comparison in one table. --all compares every policy in every test: also from
    mid-swing, at the shelf, on the independent robot, and with a search over open-loop commands (the ceiling).

    \b
    Examples:
      softarm evaluate --policy reach --json reach.json
      softarm evaluate --policy runs/mine/reach.onnx --policy reach --policy pid --report mine.html
      softarm evaluate --all --json all.json --report all.html
      softarm evaluate --all --runs runs/compare --only reach --test grid --test held_back
    """
    leaves(NOTHING)
    choice = _Choice(**chosen)
    choice.check()
    if choice.compare_all or choice.matrix or choice.tests or report or len(choice.policies) > 1:
        _compare(choice, json_file, report, workers or cores())
        return
    if workers is not None:
        raise click.UsageError("--workers goes with a comparison: --all, --test, --report or several --policy")
    _evaluate(choice, json_file)


def _compare(choice: _Choice, json_file: Path | None, report: Path | None, workers: int) -> None:
    from softarm.evaluation import page, table
    from softarm.evaluation import tests as known

    flown_model(choice.model_file)
    with failing(ValueError):
        config = load_config(choice.config_file)
        tests = choice.tests or known.default(choice.compare_all, choice.matrix)
        if choice.model_file:
            tests = tuple(known.on_model(test, choice.model_file) for test in tests)
        for test in tests:
            known.check(test)
        names = choice.only if choice.compare_all or choice.matrix else choice.policies or (DEFAULT_POLICY,)
        found = table.entries(choice.runs, names, choice.matrix, choice.files, config)
        with bar("flying", sum(len(job.part) for job in table.jobs(found, tests))) as shown:
            result = table.compare(found, workers, tests, shown.advance, config)
    click.echo(page.markdown(result), nl=False)
    write_json(json_file, result)
    if report is not None:
        write(report, page.html(result, shlex.join(["softarm", *sys.argv[1:]])))


def _evaluate(choice: _Choice, json_file: Path | None) -> None:
    from softarm.evaluation import evaluation

    (policy,) = choice.policies or (DEFAULT_POLICY,)
    config = load_config(choice.config_file)
    model = flown_model(choice.model_file)
    with bar(f"flying {policy}", evaluation.FLIGHTS) as shown:
        result = evaluation.evaluate(policy, config, model, shown.advance)
    parts = (("z <= 0.70 m", "in_range"), ("z > 0.70 m", "above"), ("all", "all"))
    rows = [(label, f"{100 * result['success'][part]:.1f} %") for label, part in parts]
    print_table(("targets", "reached"), rows, f"{policy}: 54 targets x 3 cart starts")
    click.echo(
        f"highest tip {result['max_tip_z_m']:.3f} m, farthest cart {result['max_cart_m']:.3f} m, "
        f"{result['real_time_factor']:.0f}x real time"
    )
    write_json(json_file, result)
