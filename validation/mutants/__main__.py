"""Mutate the safety-relevant modules and find the mutants that no test kills.

    python -m validation.mutants
    python -m validation.mutants --module daemon/control/safety.py

A test kills every mutant, or explained.yaml states why it may survive. Other survivors are printed in the format of
that file: write the missing test, or state why there is none to write.
"""

import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from random import Random
from typing import NamedTuple

import click
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Column, Table

from benchmarks import results
from softarm.common.processes import bar, cores
from validation.mutants import explained
from validation.mutants.explained import Explanation
from validation.mutants.operators import Mutant, mutants
from validation.mutants.targets import TARGETS, Target
from validation.mutants.trials import FailsUnchanged, Trial, trials


class Choice(NamedTuple):
    """Selection of the mutants of a module."""

    sample: int | None = None  # number, drawn with the seed
    seed: int = 0
    like: str = ""  # only mutants whose text contains this

    def of(self, every: Sequence[Mutant]) -> Sequence[Mutant]:
        """Return the selected mutants of a module."""
        alike = [mutant for mutant in every if self.like in str(mutant)]
        return alike if self.sample is None else Random(self.seed).sample(alike, min(self.sample, len(alike)))


EVERY = Choice()


class Found(NamedTuple):
    """Results of a module's mutants."""

    target: Target
    trials: list[Trial]
    explained: list[Mutant]  # survivors with an explanation
    unexplained: list[Mutant]
    needless: list[Mutant]  # killed although explained
    stale: list[Explanation]
    seconds: float

    @property
    def sound(self) -> bool:
        """Return whether no mutant needs attention."""
        return not (self.unexplained or self.stale)


def prove(
    target: Target,
    explanations: Sequence[Explanation],
    jobs: int,
    choice: Choice = EVERY,
    report: Callable[[Trial], None] = lambda _: None,
) -> Found:
    """Try the chosen mutants of a module and return the results.

    Raises:
        FailsUnchanged: The tests fail without a change.
    """
    start_s = time.monotonic()
    every = mutants(target.source)
    stale = explained.stale(explanations, target.module, every)
    known = {each.key for each in explanations if each.module == target.module}
    done = []
    for trial in trials(target, choice.of(every), jobs):
        done.append(trial)
        report(trial)
    alive = [trial.mutant for trial in done if trial.end == "survived"]
    return Found(
        target,
        done,
        [mutant for mutant in alive if explained.key(mutant) in known],
        [mutant for mutant in alive if explained.key(mutant) not in known],
        [trial.mutant for trial in done if trial.end != "survived" and explained.key(trial.mutant) in known],
        stale,
        time.monotonic() - start_s,
    )


@click.command()
@click.option(
    "--module",
    "modules",
    multiple=True,
    type=click.Choice(list(TARGETS)),
    metavar="FILE",
    help="This one alone; again for more.",
)
@click.option("--sample", type=click.IntRange(1), help="Try so many mutants of each module, drawn by the seed.")
@click.option("--seed", default=0, show_default=True, help="Of the sample.")
@click.option("--like", default="", metavar="TEXT", help="Only those that have this in what they were or are.")
@click.option("--jobs", default=cores(), show_default=True, type=click.IntRange(1), help="Mutants tried at once.")
@click.option("--killers", is_flag=True, help="Print every mutant with the test that killed it.")
@results.json_option
def main(
    modules: tuple[str, ...],
    sample: int | None,
    seed: int,
    like: str,
    jobs: int,
    killers: bool,
    json_file: Path | None,
) -> None:
    """Print a row per module, and every survivor without an explanation.

    \b
    Example:
      python -m validation.mutants --module daemon/control/goals.py --json mutants.json
    """
    explanations = explained.read()
    targets = [TARGETS[module] for module in modules] or list(TARGETS.values())
    choice = Choice(sample, seed, like)
    total = sum(len(choice.of(mutants(target.source))) for target in targets)
    found = []
    try:
        with bar("mutants", total) as shown:
            for target in targets:
                shown.advance(0, target.module)
                found.append(prove(target, explanations, jobs, choice, lambda _: shown.advance()))
    except FailsUnchanged as error:
        raise click.ClickException(str(error)) from None
    _print(found, killers)
    if json_file is not None:
        results.write(json_file, {"modules": {each.target.module: figures(each) for each in found}})
    raise SystemExit(not all(each.sound for each in found))


def figures(found: Found) -> dict[str, object]:
    """Return the stored figures of a module."""
    ends = Counter(trial.end for trial in found.trials)
    return {
        "tried": len(found.trials),
        "killed": ends["killed"],
        "timed_out": ends["timed out"],
        "explained": len(found.explained),
        "unexplained": len(found.unexplained),
        "seconds": round(found.seconds, 1),
        "tests": list(found.target.tests),
    }


def _print(found: Sequence[Found], killers: bool) -> None:
    console = Console()
    table = Table(Column("module", no_wrap=True), "tried", "killed", "ended", "explained", "left", "s", box=SIMPLE)
    for each in found:
        numbers = figures(each)
        names = ("tried", "killed", "timed_out", "explained", "unexplained", "seconds")
        table.add_row(each.target.module, *(str(numbers[name]) for name in names))
    console.print(table)
    for each in found:
        if killers:
            for trial in each.trials:
                click.echo(f"{each.target.module}: {trial.mutant}: {trial.end} {trial.by} {trial.seconds:.1f} s")
        _report(each)


def _report(found: Found) -> None:
    module = found.target.module
    for old in found.stale:
        click.echo(f"{module}: the list explains what is not there any more, take it out: {old.function}: {old.was}")
    for mutant in found.needless:
        click.echo(f"{module}: the list explains what a test kills by now, take it out: {mutant}")
    if found.unexplained:
        click.echo(f"\n# No test notices; explained.yaml would say why none needs to:\n{module}:")
    for mutant in found.unexplained:
        click.echo(explained.as_entry(mutant))


if __name__ == "__main__":
    main()
