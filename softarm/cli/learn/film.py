"""The film of `softarm evaluate --film`."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.shared.interrupt import leaves
from softarm.cli.shared.options import write_bytes
from softarm.cli.shared.printing import waiting

if TYPE_CHECKING:
    from softarm.evaluation.entries import Entry
    from softarm.schemas.config import Config


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
        with waiting(f"drawing {file}"):
            content = films.encode(first.name, flown, robot, config, file.suffix)
        click.echo(films.sentence(first.name, flown))
        write_bytes(file, content)

    return write_film
