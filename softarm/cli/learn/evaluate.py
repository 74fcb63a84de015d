"""`softarm evaluate`: how often policies reach their targets, flown by the real control loop."""

import shlex
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from softarm.cli.shared.completion import policies_and_files
from softarm.cli.shared.console import (
    FILE,
    FOLDER,
    NUMBER,
    check_places,
    config_option,
    flown_model,
    json_option,
    load_config,
    model_option,
    print_table,
    typed,
    waiting,
    write,
    write_bytes,
    write_json,
)
from softarm.cli.shared.errors import NOTHING, fail, failing, leaves
from softarm.common.batch import Workers, workers_options
from softarm.common.processes import bar

if TYPE_CHECKING:
    from softarm.evaluation.entries import Entry
    from softarm.evaluation.leaderboard import Row
    from softarm.schemas.config import Config
    from softarm.schemas.model import Model

DEFAULT_POLICY = "reach"


@dataclass(frozen=True)
class Choice:
    """Arguments and options of one call, by their names in the command."""

    policies: tuple[str, ...]
    config_file: Path | None
    model_file: Path | None
    compare_all: bool
    runs: Path | None
    only: tuple[str, ...]
    tests: tuple[str, ...]
    matrix: bool
    faults: bool
    report: Path | None
    film: Path | None
    target: tuple[float, float] | None
    workers: Workers
    keep: Path | None
    leaderboard: Path | None
    json_file: Path | None

    def check(self) -> None:
        """Raise UsageError for options that have no effect together, and Failure for a place that does not exist."""
        if (self.runs or self.only) and not (self.compare_all or self.matrix):
            raise click.UsageError(
                "--runs and --only go with --all. Without --all, name each policy or folder: softarm evaluate POLICY..."
            )
        if self.matrix and self.runs is None:
            raise click.UsageError("--matrix is about a sweep: give its folder with --runs")
        if self.matrix and (self.policies or self.model_file or self.compare_all):
            raise click.UsageError(
                "--matrix flies a sweep's policies on every shipped model: omit POLICY, --model and --all"
            )
        others = (self.compare_all, self.matrix, self.tests, self.model_file, self.keep)
        if self.faults and any((*others, self.film, self.report, self.leaderboard)):
            raise click.UsageError(
                "--faults has its own flights and table: omit all options but --config, --workers, --ray and --json"
            )
        if self.model_file and (own := [test for test in self.tests if "@" in test]):
            raise click.UsageError(f"--test {own[0]} names a model itself: omit --model, or @ and what follows")
        if self.target and self.film is None:
            raise click.UsageError("--target Y Z is the target of the film: add --film FILE.gif")
        if self.leaderboard and self.model_file:
            raise click.UsageError("--leaderboard holds results of the seed's simulator: omit --model")
        check_places(self.json_file, self.report, self.film, self.leaderboard)


@click.command()
@click.argument("policies", nargs=-1, metavar="[POLICY]...", shell_complete=policies_and_files)
@json_option
@config_option
@model_option
@click.option("--all", "compare_all", is_flag=True, help="Compare all policies in all tests, and the files of POLICY.")
@click.option("--report", type=FILE, help="Write the comparison with maps of the targets as one HTML file.")
@click.option("--film", type=FILE, help="Write one flight of the first policy as FILE.gif, or FILE.mp4 with ffmpeg.")
@click.option(
    "--target",
    type=(NUMBER, NUMBER),
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
    from softarm.evaluation.entries import CEILING

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
    compared = wanted or len(found) > 1 or found[0].name == CEILING
    if not compared and (wrong := [name for name in typed() if name in ("--workers", "--ray", "--keep")]):
        raise click.UsageError(f"{wrong[0]} goes with a comparison: --all, --test, --report or several policies")
    with failing(ValueError):
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


def _evaluate(choice: Choice, entry: "Entry", config: "Config", model: "Model | None") -> None:
    from softarm.evaluation import runner

    with bar(f"flying {entry.name}", runner.FLIGHTS) as shown:
        result = runner.evaluate(entry.name, config, model, shown.advance, entry.file)
    parts = (("z <= 0.70 m", "in_range"), ("z > 0.70 m", "above"), ("all", "all"))
    rows = [(label, f"{100 * result['success'][part]:.1f} %") for label, part in parts]
    print_table(("targets", "reached"), rows, f"{entry.name}: 54 targets x 3 cart starts")
    click.echo(
        f"highest tip {result['max_tip_z_m']:.3f} m, farthest cart {result['max_cart_m']:.3f} m, "
        f"{result['real_time_factor']:.0f}x real time"
    )
    write_json(choice.json_file, result)


def compare(choice: Choice, found: "Sequence[Entry]", tests: tuple[str, ...], config: "Config") -> None:
    """Fly the policies in the tests, print their table, and write the files of the choice.

    Ends the command if a leaderboard is given, and the limits or goals of the configuration are not the default ones.
    """
    from softarm.evaluation import leaderboard, page, table
    from softarm.schemas.config import Config

    if choice.leaderboard is not None:
        leaderboard.load(choice.leaderboard)
        if (config.limits, config.goals) != (Config().limits, Config().goals):
            fail("--leaderboard: results need the default limits and goals: omit both in --config")
    command = shlex.join(["softarm", *sys.argv[1:]])
    if choice.keep is not None:
        leaves(f"finished jobs are kept in {choice.keep}; the same command continues")
    result = table.compare(found, choice.workers, tests, config, choice.keep)
    click.echo(page.markdown(result), nl=False)
    write_json(choice.json_file, result)
    if choice.report is not None:
        write(choice.report, page.html(result, command))
    if choice.leaderboard is not None:
        _rank(choice.leaderboard, leaderboard.rows(result, found, command))


def _rank(file: Path, rows: "list[Row]") -> None:
    """Add rows to a leaderboard, or end the command with exit code 1 if an entry is not reproduced."""
    from softarm.evaluation import leaderboard

    before = leaderboard.load(file)
    board, sentences, same = leaderboard.merged(before, rows)
    click.echo("\n".join(sentences))
    if board != before:
        write_json(file, board.model_dump(mode="json"))
    if not same:
        fail(f"{file}: not every entry was reproduced; check revision and configuration")


def worst(choice: Choice, found: "Sequence[Entry]", config: "Config") -> None:
    """Print the success with each strong fault, and the worst.

    Ends the command if the independent robot is not installed, or the ceiling, which cannot fly it, is among the rows.
    """
    from softarm.evaluation import faults
    from softarm.evaluation import tests as known
    from softarm.evaluation.entries import CEILING

    if any(entry.name == CEILING for entry in found):
        fail(f"{CEILING}: is searched on the simulator alone; omit it, or omit --faults")
    with failing(ValueError):
        known.check("held_back")
    result = faults.measure(found, choice.workers, config)
    print_table(*faults.lines(result), "targets reached from rest / in mid-swing, %")
    write_json(choice.json_file, result)


def film(
    file: Path,
    target_m: tuple[float, float] | None,
    found: "Sequence[Entry]",
    tests: tuple[str, ...],
    config: "Config",
) -> Callable[[], None]:
    """Fly what a film shows, before minutes of work, and return a function that draws and writes it."""
    from softarm.evaluation import film as films
    from softarm.evaluation import tests as known
    from softarm.evaluation.entries import CEILING
    from softarm.evaluation.runner import load

    films.check(file)
    wanted, robot = films.candidates(tests[0], target_m, config), known.robot(tests[0])
    first = next((entry for entry in found if entry.name != CEILING), None)
    if first is None:
        raise ValueError(f"--film {file}: {CEILING} is a search, not a policy; name a policy")
    with waiting(f"flying for {file}"):
        flown = films.fly(load(first.file or first.name, config), robot, wanted, config)

    def write_film() -> None:
        leaves(f"{file} was not written")
        with failing(ValueError), waiting(f"drawing {file}"):
            content = films.encode(first.name, flown, robot, config, file.suffix)
        click.echo(films.sentence(first.name, flown))
        write_bytes(file, content)

    return write_film
