"""Comparison of policies for `softarm evaluate`: its table, report and leaderboard."""

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.learn.choice import Choice
from softarm.cli.shared.errors import fail
from softarm.cli.shared.interrupt import leaves
from softarm.cli.shared.options import write, write_json
from softarm.cli.shared.printing import print_table

if TYPE_CHECKING:
    from softarm.evaluation.entries import Entry
    from softarm.evaluation.leaderboard import Row
    from softarm.schemas.config import Config


def compare(choice: Choice, found: "Sequence[Entry]", tests: tuple[str, ...], config: "Config") -> None:
    """Fly the policies in the tests, print their table, and write the files of the choice.

    Raises:
        ValueError: a leaderboard is given, and the limits or goals of the configuration are not the default ones.
    """
    from softarm.evaluation import leaderboard, page, table
    from softarm.schemas.config import Config

    if choice.leaderboard is not None:
        leaderboard.load(choice.leaderboard)
        if (config.limits, config.goals) != (Config().limits, Config().goals):
            raise ValueError("--leaderboard: results need the default limits and goals: omit both in --config")
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
        write(file, leaderboard.text(board))
    if not same:
        fail(f"{file}: not every entry was reproduced; check revision and configuration")


def worst(choice: Choice, found: "Sequence[Entry]", config: "Config") -> None:
    """Print the success with each strong fault, and the worst.

    Raises:
        ValueError: the independent robot is not installed, or the ceiling, which cannot fly it, is among the rows.
    """
    from softarm.evaluation import faults
    from softarm.evaluation import tests as known
    from softarm.evaluation.entries import CEILING

    if any(entry.name == CEILING for entry in found):
        raise ValueError(f"{CEILING}: is searched on the simulator alone; omit it, or omit --faults")
    known.check("held_back")
    result = faults.measure(found, choice.workers, config)
    print_table(*faults.lines(result), "targets reached from rest / in mid-swing, %")
    write_json(choice.json_file, result)
