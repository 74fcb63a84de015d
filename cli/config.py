"""`softarm config`: write a new configuration; look up its keys."""

from pathlib import Path

import click

from softarm.cli.errors import fail
from softarm.cli.options import FILE, write
from softarm.cli.printing import print_json, print_option, print_table
from softarm.cli.verbs import Verbs

WIDTH = 160  # of the table where there is no terminal


@click.group(cls=Verbs)
def config() -> None:
    """Write a new configuration; look up what its keys take, and in which unit.

    \b
    Examples:
      softarm config new                   softarm.yaml, every key at its default, with a word on each
      softarm config new --twin            twin.yaml, for a robot that is not there
      softarm config units rail            all keys with "rail" in their name
    """


@config.command()
@click.argument("file", required=False, type=FILE)
@click.option("--simulated", "kind", flag_value="simulated", help="For `softarm run --simulated`: without wires.")
@click.option("--twin", "kind", flag_value="twin", help="For `softarm twin` and the daemon on one machine.")
def new(file: Path | None, kind: str | None) -> None:
    """Write a new configuration FILE (default softarm.yaml, with --twin twin.yaml). It overwrites none.

    \b
    Examples:
      softarm config new
      softarm config new mine.yaml --simulated
      softarm config new --twin
    """
    from softarm.daemon.config import keys

    file = file or Path("twin.yaml" if kind == "twin" else "softarm.yaml")
    if file.exists():
        fail(f"{file}: is there already, and stays as it is; name another file, or move it away")
    match kind:
        case "twin":
            text, runs = (
                keys.for_the_twin(),
                f"softarm twin --config {file}`, and beside it `softarm run --config {file}",
            )
        case "simulated":
            text, runs = keys.for_a_simulated_robot(), f"softarm run --simulated --config {file}"
        case _:
            text, runs = keys.for_a_robot(), f"softarm doctor --config {file}`, then `softarm run --config {file}"
    write(file, text)
    click.echo(f"next: `{runs}`; `softarm config units` tells what each key takes")


@config.command()
@click.argument("part", default="")
@print_option
def units(part: str, as_json: bool) -> None:
    """Print every key with unit, allowed range, default and meaning; PART: only those whose name holds it.

    \b
    Examples:
      softarm config units
      softarm config units recorder
      softarm config units --json
    """
    from softarm.daemon.config import keys

    found = [row for row in keys.rows() if part.lower() in row.key]
    if not found:
        fail(f"no key has '{part}' in its name; `softarm config units` lists all")
    if as_json:
        print_json([row._asdict() for row in found])
    else:
        print_table(("key", "unit", "allowed", "default", "meaning"), found, width=WIDTH)
