"""Command line of the fault matrix."""

from pathlib import Path

import click

from benchmarks import results
from softarm.common.processes import bar
from validation.matrix.cells import cells, faults_of
from validation.matrix.flight import fly_all


@click.command()
@click.option("--only", metavar="TEXT", help="Only cells whose name (`rail, read: garbage`) contains this.")
@results.json_option
def main(only: str | None, json_file: Path | None) -> None:
    """Cause each fault; exit with 1 if an outcome was unsafe or attributed to the wrong device.

    \b
    Examples:
      python -m validation.matrix --only "rail, read"
      python -m validation.matrix --json matrix.json
    """
    chosen = [cell for cell in cells() if only is None or only in str(cell)]
    if not chosen:
        raise click.BadParameter(f"no cell has this name; allowed: {', '.join(str(cell) for cell in cells())}")
    figures = []
    with bar("causing faults", len(chosen)) as shown:
        for cell, outcome in fly_all(chosen):
            figures.append({**vars(cell), **vars(outcome), "wrong": faults_of(cell, outcome)})
            shown.advance(1)
    results.report("matrix", {"cells": figures}, json_file)
    raise SystemExit(any(cell["wrong"] for cell in figures))


if __name__ == "__main__":
    main()
