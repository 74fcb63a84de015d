"""`python -m softarm.benchmarks.matrix`."""

import sys
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table

from softarm.benchmarks import results
from softarm.benchmarks.matrix.cells import Cell, Outcome, cells, faults_of
from softarm.benchmarks.matrix.flight import fly_all
from softarm.common.processes import bar
from softarm.flights.software_in_the_loop import SoftwareInTheLoopError


@click.command()
@click.option("--only", metavar="TEXT", help="Cells whose name (`rail, read: garbage`) holds this.")
@results.json_option
def main(only: str | None, json_file: Path | None) -> None:
    """Make each thing go wrong; end with 1 when a cell was unsafe or the wrong one was blamed.

    \b
    Examples:
      python -m softarm.benchmarks.matrix --only "rail, read"
      python -m softarm.benchmarks.matrix --json matrix.json
    """
    chosen = [cell for cell in cells() if only is None or only in str(cell)]
    if not chosen:
        raise click.BadParameter(f"no cell is called so; there are {', '.join(str(cell) for cell in cells())}")
    left: list[tuple[Cell, Outcome]] = []
    try:
        with bar("breaking", len(chosen)) as shown:

            def report(cell: Cell, outcome: Outcome) -> None:
                left.append((cell, outcome))
                shown.advance(1)

            fly_all(chosen, report)
    except SoftwareInTheLoopError as error:
        raise click.ClickException(str(error)) from None
    if json_file is not None:
        figures = [{**vars(cell), **outcome.as_json(), "wrong": faults_of(cell, outcome)} for cell, outcome in left]
        results.write(json_file, {"cells": figures})
    table = Table("what goes wrong", "stopped", "braked / vented (ms)", "farthest (m)", "causes", "wrong")
    for cell, outcome in left:
        took = " / ".join("-" if ms is None else f"{ms:.0f}" for ms in (outcome.braked_ms, outcome.vented_ms))
        causes, wrong = ", ".join(outcome.causes), "; ".join(faults_of(cell, outcome))
        table.add_row(str(cell), str(outcome.stopped), took, f"{outcome.farthest_m:.3f}", causes, wrong)
    Console(width=None if sys.stdout.isatty() else 240).print(table)
    if any(faults_of(cell, outcome) for cell, outcome in left):
        sys.exit(1)


if __name__ == "__main__":
    main()
