"""Feed every parser of the project with invalid input.

Each parser promises, within bounded time and memory, either a value or its own error with a message: no other
exception, no hang, no crash of the process. A parser and a number identify a case, so every case can be repeated.

    python -m validation.fuzz --minutes 60
    python -m validation.fuzz --only yaml.configuration --case 4711
"""

import time

import click

from softarm.common.processes import bar
from validation.fuzz.parsers import PARSERS
from validation.fuzz.trials import Fuzzed, draw, fuzz, made


@click.command()
@click.option(
    "--minutes", default=60.0, show_default=True, type=click.FloatRange(0, min_open=True), help="Total duration."
)
@click.option("--only", multiple=True, type=click.Choice(list(PARSERS)), help="Only this parser; may be repeated.")
@click.option("--first", default=0, show_default=True, help="Number of the first case, to continue an earlier run.")
@click.option("--case", type=int, help="With one --only: run only this case, in this process, with its traceback.")
def main(minutes: float, only: tuple[str, ...], first: int, case: int | None) -> None:
    """Feed every parser with invalid examples; exit with 1 if one breaks its promise.

    \b
    Example:
      python -m validation.fuzz --minutes 60
    """
    if case is not None:
        if len(only) != 1:
            raise click.UsageError("--case needs one parser: name it with --only")
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
    for name, each in found.items():
        click.echo(f"{name:20} {each.cases:10,} cases, {len(each.findings)} findings")
    findings = [finding for each in found.values() for finding in each.findings]
    for finding in findings:
        click.echo(f"{finding.parser} case {finding.case}: {finding.what}")
    raise SystemExit(bool(findings))


if __name__ == "__main__":
    main()
