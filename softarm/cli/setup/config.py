"""`softarm config`: write a new configuration or look up its keys."""

from pathlib import Path

import click

from softarm.cli.shared.console import FILE, WIDE, print_json, print_option, print_table, write
from softarm.cli.shared.errors import fail


@click.group()
def config() -> None:
    """Write a new configuration, or look up its keys with unit and range.

    \b
    Examples:
      softarm config new                   softarm.yaml with every key, its default and a comment
      softarm config new --twin            twin.yaml, for a simulated robot
      softarm config units rail            all keys with "rail" in their name
    """


@config.command()
@click.argument("file", required=False, type=FILE)
@click.option("--simulated", "kind", flag_value="simulated", help="For `softarm run --simulated`: without devices.")
@click.option("--twin", "kind", flag_value="twin", help="For `softarm twin` and the daemon on one computer.")
def new(file: Path | None, kind: str | None) -> None:
    """Write a new configuration FILE (default softarm.yaml, with --twin twin.yaml). Existing files are kept.

    \b
    Examples:
      softarm config new
      softarm config new mine.yaml --simulated
      softarm config new --twin
    """
    from softarm.daemon.config import configuration

    file = file or Path("twin.yaml" if kind == "twin" else "softarm.yaml")
    if file.exists():
        fail(f"{file}: exists and was not changed; choose another name or move the file")
    if kind == "twin":
        text = configuration.TWIN.read_text(encoding="utf-8")
        following = f"`softarm twin --config {file}`, and in another terminal `softarm run --config {file}`"
    elif kind == "simulated":
        text = configuration.for_a_simulated_robot()
        following = f"`softarm run --simulated --config {file}`"
    else:
        text = configuration.EXAMPLE.read_text(encoding="utf-8")
        following = f"`softarm doctor --config {file}`, then `softarm run --config {file}`"
    write(file, text)
    click.echo(f"next: {following}; `softarm config units` explains each key")


@config.command()
@click.argument("part", default="")
@print_option
def units(part: str, as_json: bool) -> None:
    """Print every key with unit, allowed range, default and meaning, or only keys whose name contains PART.

    \b
    Examples:
      softarm config units
      softarm config units recorder
      softarm config units --json
    """
    from softarm.daemon.config import configuration

    found = [row for row in configuration.key_rows() if part.lower() in row.key]
    if not found:
        fail(f"no key contains '{part}'; `softarm config units` lists all")
    if as_json:
        print_json([row._asdict() for row in found])
    else:
        print_table(("key", "unit", "allowed", "default", "meaning"), found, width=WIDE)
