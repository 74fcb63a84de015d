"""`softarm evaluate`: how often policies reach their targets, flown by the real control loop."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from softarm.cli.learn.choice import Choice
from softarm.cli.learn.compare import compare, worst
from softarm.cli.learn.film import film
from softarm.cli.shared.completion import policies_and_files
from softarm.cli.shared.errors import failing
from softarm.cli.shared.interrupt import NOTHING, leaves
from softarm.cli.shared.options import (
    FILE,
    FOLDER,
    config_option,
    flown_model,
    json_option,
    load_config,
    model_option,
    typed,
    write_json,
)
from softarm.cli.shared.printing import print_table
from softarm.common.batch_options import workers_options
from softarm.common.processes import bar

if TYPE_CHECKING:
    from softarm.evaluation.entries import Entry
    from softarm.schemas.config import Config
    from softarm.schemas.model import Model

DEFAULT_POLICY = "reach"


def _renamed(_: click.Context, __: click.Parameter, given: tuple[str, ...]) -> None:
    if given:
        raise click.UsageError(
            f"--policy is no option any more: name policies without it: softarm evaluate {shlex.join(given)}"
        )


@click.command()
@click.argument("policies", nargs=-1, metavar="[POLICY]...", shell_complete=policies_and_files)
@click.option("--policy", multiple=True, hidden=True, expose_value=False, callback=_renamed)
@json_option
@config_option
@model_option
@click.option("--all", "compare_all", is_flag=True, help="Compare all policies in all tests, and the files of POLICY.")
@click.option("--report", type=FILE, help="Write the comparison with maps of the targets as one HTML file.")
@click.option("--film", type=FILE, help="Write one flight of the first policy as FILE.gif, or FILE.mp4 with ffmpeg.")
@click.option(
    "--target",
    type=(float, float),
    metavar="Y Z",
    help="With --film: its target, m.  [default: the highest one that the policy reaches]",
)
@click.option(
    "--runs",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    help="With --all: a sweep's folder; its policies replace shipped ones of the same name.",
)
@click.option("--only", multiple=True, metavar="NAME", help="With --all: only this policy, or `ceiling`; repeatable.")
@click.option("--test", "tests", multiple=True, help="Fly this test, TEST or TEST@MODEL; repeatable.")
@click.option("--matrix", is_flag=True, help="With --runs: fly the sweep alone, on every shipped model.")
@click.option(
    "--leaderboard", type=FILE, help="Add the results to this file, or check the entry of the same policy in it."
)
@click.option("--faults", is_flag=True, help="Fly the independent robot with one strong fault after another.")
@click.option("--keep", type=FOLDER, help="Of a comparison: keep finished jobs here; the same command continues.")
@workers_options("Of a comparison: ")
def evaluate(**chosen: Any) -> None:
    """Fly the 54 test targets from rest at cart positions 0, 0.1 and 0.2 m, in lockstep at 1200 Hz.

    POLICY is a name of `softarm policy list`, an ONNX file, or the folder of a training run or sweep; `reach` if none
    is given. Write ./NAME for a folder that has the name of a policy.

    Observer, policy, safety filter and failsafe are those of the daemon; only the devices are simulated. Several
    policies, --test or --report give a comparison in one table. --all compares every policy in every test: also from
    mid-swing, at the shelf, on the independent robot, and with a search over open-loop commands (the ceiling).

    \b
    Examples:
      softarm evaluate reach --json reach.json
      softarm evaluate mine.onnx runs/mine reach pid --config mine.yaml --report out.html
      softarm evaluate mine.onnx --leaderboard leaderboard.json     add an entry, or reproduce it
      softarm evaluate runs/mine --film swing.gif --target -0.3 0.65
      softarm evaluate --all --json all.json --report all.html
      softarm evaluate reach-robust mine.onnx --faults
      softarm evaluate --all --runs runs/compare --only reach --test grid --test held_back
    """
    leaves(NOTHING)
    choice = Choice(**chosen)
    choice.check()
    config = load_config(choice.config_file)
    model = flown_model(choice.model_file)
    with failing(ValueError):
        tests = _tests(choice)
        found = _entries(choice, tests, config)
        if choice.faults:
            worst(choice, found, config)
            return
        wanted = choice.compare_all or choice.matrix or choice.tests or choice.report or choice.leaderboard
        compared = wanted or _needs_table(found)
        if not compared and (wrong := [name for name in typed() if name in ("--workers", "--ray", "--keep")]):
            raise click.UsageError(f"{wrong[0]} goes with a comparison: --all, --test, --report or several policies")
        write_film = None if choice.film is None else film(choice.film, choice.target, found, tests, config)
        if compared:
            compare(choice, found, tests, config)
        else:
            _evaluate(choice, found[0], config, model)
        if write_film is not None:
            write_film()


def _tests(choice: Choice) -> tuple[str, ...]:
    """Return the tests to fly. Raises ValueError for an unknown one, or if none takes the model of --model."""
    from softarm.evaluation import tests as known

    tests = choice.tests or known.default(choice.compare_all, choice.matrix)
    for test in tests:
        known.check(test)
    if choice.model_file is None:
        return tests
    if all(map(known.is_independent, tests)):
        raise ValueError(f"--test {tests[0]} flies the independent robot, which takes no model: omit --model")
    return tuple(known.on_model(test, choice.model_file) for test in tests)


def _entries(choice: Choice, tests: tuple[str, ...], config: "Config") -> "list[Entry]":
    """Return the rows of the table, those of POLICY first; raise PolicyError for one that cannot be flown."""
    from softarm.evaluation import entries, table

    every = choice.compare_all or choice.matrix
    found = entries.given(choice.policies or (() if every else (DEFAULT_POLICY,)), config)
    if every:
        if named := [entry.name for entry in found if entry.file is None]:
            raise click.UsageError(
                f"{named[0]}: --all flies every policy that has a name. Choose rows with --only; POLICY adds files "
                "and training folders"
            )
        found += entries.every(choice.runs, choice.only, choice.matrix, config)
    for entry in found:
        if not every and not table.jobs([entry], tests):
            raise ValueError(f"{entry.name}: is searched in the test grid alone; add --test grid")
    return found


def _needs_table(found: "Sequence[Entry]") -> bool:
    from softarm.evaluation.entries import CEILING

    return len(found) > 1 or found[0].name == CEILING


def _evaluate(choice: Choice, entry: "Entry", config: "Config", model: "Model | None") -> None:
    from softarm.evaluation import evaluation

    with bar(f"flying {entry.name}", evaluation.FLIGHTS) as shown:
        result = evaluation.evaluate(entry.name, config, model, shown.advance, entry.file)
    parts = (("z <= 0.70 m", "in_range"), ("z > 0.70 m", "above"), ("all", "all"))
    rows = [(label, f"{100 * result['success'][part]:.1f} %") for label, part in parts]
    print_table(("targets", "reached"), rows, f"{entry.name}: 54 targets x 3 cart starts")
    click.echo(
        f"highest tip {result['max_tip_z_m']:.3f} m, farthest cart {result['max_cart_m']:.3f} m, "
        f"{result['real_time_factor']:.0f}x real time"
    )
    write_json(choice.json_file, result)
