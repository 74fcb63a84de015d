"""Mutate the safety-relevant modules and find the mutants that no test kills.

    python -m validation.mutants
    python -m validation.mutants --module daemon/control/safety.py

A test kills every mutant, or explained.yaml states why it may survive. Other survivors are printed in the format of
that file: write the missing test, or state why there is none to write.
"""

import time
from collections import Counter
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import click
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Column, Table

from softarm.common import yaml_lines
from softarm.common.processes import bar, cores
from validation.mutants.operators import Key, Mutant, mutants
from validation.mutants.targets import TARGETS, Target
from validation.mutants.trials import trials

FILE = Path(__file__).with_name("explained.yaml")


def explanations() -> dict[str, dict[Key, str]]:
    """Return the reasons of the file: module -> key of the mutant -> reason. Raises FileError, KeyError, ValueError."""
    modules = yaml_lines.read(FILE, "it lists the mutants that may live").data or {}
    return {
        module: {key: entry["why"] for entry in entries for key in _keys(entry)} for module, entries in modules.items()
    }


def _keys(entry: dict[str, Any]) -> list[Key]:
    if not entry["why"]:
        raise ValueError(f"an entry says why the mutant may live: {entry}")
    instead = entry["now"] if isinstance(entry["now"], list) else [entry["now"]]
    return [(entry["in"], entry["was"], now, entry.get("which", 1)) for now in instead]


def as_entry(mutant: Mutant) -> str:
    """Return a mutant in the format of the file, for a person to add the reason."""
    was, now = (text.replace("'", "''") for text in (mutant.was, mutant.now))
    lines = [f"in: {mutant.function}", f"was: '{was}'", f"now: '{now}'"]
    lines += [f"which: {mutant.which}"] if mutant.which > 1 else []
    return "  - " + "\n    ".join([*lines, "why:"])


class Found(NamedTuple):
    """Results of a module's mutants."""

    figures: dict[str, float]
    unexplained: list[Mutant]  # survivors without an explanation
    needless: list[Mutant]  # killed although explained
    stale: set[Key]  # explanations whose code no longer exists


def prove(target: Target, jobs: int, sample: int | None = None, seed: int = 0) -> Found:
    """Try the mutants of a module, or a sample of them. Raises FailsUnchanged as `trials` does."""
    start_s = time.monotonic()
    known = explanations().get(target.module, {})
    chosen = every = mutants(target.source)
    if sample is not None:
        chosen = Random(seed).sample(every, min(sample, len(every)))
    done = list(zip(chosen, trials(target, chosen, jobs), strict=True))
    ends = Counter(end for _, end in done)
    unexplained = [mutant for mutant, end in done if end == "survived" and mutant.key not in known]
    figures = {
        "tried": len(done),
        "killed": ends["killed"],
        "timed_out": ends["timed out"],
        "explained": ends["survived"] - len(unexplained),
        "unexplained": len(unexplained),
        "seconds": round(time.monotonic() - start_s, 1),
    }
    needless = [mutant for mutant, end in done if end != "survived" and mutant.key in known]
    return Found(figures, unexplained, needless, known.keys() - {mutant.key for mutant in every})


@click.command()
@click.option(
    "--module",
    "modules",
    multiple=True,
    type=click.Choice(list(TARGETS)),
    default=TARGETS,
    metavar="FILE",
    help="This one alone; again for more.",
)
@click.option("--sample", type=click.IntRange(1), help="Try so many mutants of each module, drawn by the seed.")
@click.option("--seed", default=0, show_default=True, help="Of the sample.")
@click.option("--jobs", default=cores(), show_default=True, type=click.IntRange(1), help="Mutants tried at once.")
def main(modules: tuple[str, ...], sample: int | None, seed: int, jobs: int) -> None:
    """Print a row per module, and every survivor without an explanation.

    \b
    Example:
      python -m validation.mutants --module daemon/control/goals.py
    """
    found = {}
    with bar("mutants", len(modules)) as shown:
        for module in modules:
            found[module] = prove(TARGETS[module], jobs, sample, seed)
            shown.advance(1, module)
    table = Table(Column("module", no_wrap=True), *next(iter(found.values())).figures, box=SIMPLE)
    for module, each in found.items():
        table.add_row(module, *map(str, each.figures.values()))
    Console().print(table)
    for module, each in found.items():
        for old in each.stale:
            click.echo(f"{module}: explained.yaml explains code that does not exist, remove it: {old}")
        for mutant in each.needless:
            click.echo(f"{module}: explained.yaml explains a mutant that a test kills, remove it: {mutant}")
        if each.unexplained:
            click.echo(f"\n# No test notices; explained.yaml would say why none needs to:\n{module}:")
        for mutant in each.unexplained:
            click.echo(as_entry(mutant))
    raise SystemExit(any(each.unexplained or each.stale for each in found.values()))


if __name__ == "__main__":
    main()
