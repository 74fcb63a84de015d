"""Every parser of the house, fed with what it should refuse.

The promise of each: within a bounded time and memory either the value, or the house's own error with a sentence. Never
another exception, never a hang, and no process that dies. A case is known by its parser and its number: any of them can
be tried again.

    python -m softarm.benchmarks.prove.fuzz --minutes 60
    python -m softarm.benchmarks.prove.fuzz --only yaml.configuration --case 4711
"""

import time
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table

from softarm.benchmarks import results
from softarm.benchmarks.prove.fuzz.parsers import PARSERS
from softarm.benchmarks.prove.fuzz.trials import Fuzzed, draw, fuzz, made
from softarm.common.processes import bar


@click.command()
@click.option("--minutes", default=60.0, show_default=True, type=click.FloatRange(0, min_open=True), help="In all.")
@click.option("--only", multiple=True, type=click.Choice(list(PARSERS)), help="This parser alone; again for more.")
@click.option("--first", default=0, show_default=True, help="Number of the first case: go on where a run has ended.")
@click.option("--case", type=int, help="With one --only: try this case alone, in this process, with its traceback.")
@results.json_option
def main(minutes: float, only: tuple[str, ...], first: int, case: int | None, json_file: Path | None) -> None:
    """Feed every parser with broken examples; exit code 1 when one breaks its promise.

    \b
    Example:
      python -m softarm.benchmarks.prove.fuzz --minutes 60 --json fuzz.json
    """
    if case is not None:
        if len(only) != 1:
            raise click.UsageError("--case is of one parser: name it with --only")
        fed = draw(only[0], case)
        click.echo(repr(fed)[:3000])
        click.echo(f"taken: {made(only[0]).take(fed)!r}"[:1000])
        return
    names = only or tuple(PARSERS)
    share_s = 60 * minutes / len(names)
    found: dict[str, Fuzzed] = {}
    with bar("fuzzing", 60.0 * minutes) as shown:
        for number, name in enumerate(names):
            begun_s = time.monotonic()
            for so_far in fuzz(name, share_s, first):
                found[name] = so_far
                shown.show(number * share_s + time.monotonic() - begun_s, text=name)
    if json_file is not None:
        told = {
            name: {"cases": each.cases, "findings": [f._asdict() for f in each.findings]}
            for name, each in found.items()
        }
        results.write(json_file, {"parsers": told})
    table = Table("parser", "cases", "findings")
    for name, each in found.items():
        table.add_row(name, f"{each.cases:,}", str(len(each.findings)))
    Console().print(table)
    findings = [finding for each in found.values() for finding in each.findings]
    for finding in findings:
        click.echo(f"{finding.parser} case {finding.case}: {finding.what}")
    raise SystemExit(bool(findings))


if __name__ == "__main__":
    main()
