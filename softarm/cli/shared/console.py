"""Parameter types, options, files and printing that several verbs share."""

import json
import math
import os
import shlex
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from softarm.cli.shared.completion import models
from softarm.cli.shared.errors import fail
from softarm.common import files

if TYPE_CHECKING:
    from softarm.schemas.config import Config
    from softarm.schemas.model import Model


class Number(click.FloatRange):
    """Finite number, optionally within a range."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number; NaN compares as within any range, so it is refused here."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            allowed = "" if self.min is None and self.max is None else f" in the range {self._describe_range()}"
            self.fail(f"{value} is not a finite number; allowed are finite numbers{allowed}; correct it.", param, ctx)
        return number


NUMBER = Number()
FILE = click.Path(path_type=Path, dir_okay=False)
INPUT = click.Path(path_type=Path)
FOLDER = click.Path(path_type=Path, file_okay=False)

json_option = click.option("--json", "json_file", type=FILE, help="Write the results to this file.")
config_option = click.option("--config", "config_file", type=FILE, help="The YAML file; default values without.")
model_option = click.option(
    "--model",
    "model_file",
    type=FILE,
    shell_complete=models,
    help="Model of the robot: a file, or a shipped name such as no-delay (default: seed).",
)
token_option = click.option(
    "--token-file", type=FILE, help="File with the API's token; else $SOFTARM_TOKEN. Not needed on loopback."
)
url_option = click.option(
    "--url", envvar="SOFTARM_URL", show_envvar=True, help="Address of the daemon (default: from the file)."
)


def typed() -> list[str]:
    """Return the arguments and options of the running verb that were typed, by their names on the command line."""
    context = click.get_current_context()
    parameters = ((each, context.get_parameter_source(each.name or "")) for each in context.command.params)
    return [
        each.human_readable_name if isinstance(each, click.Argument) else each.opts[0]
        for each, source in parameters
        if source is ParameterSource.COMMANDLINE
    ]


def given(*names: str) -> str:
    """Return options of the running verb that were typed, as text for another command; empty if none was."""
    context = click.get_current_context()
    options = ((each.opts[0], each.name or "") for each in context.command.params if each.name in names)
    return "".join(
        f" {option} {shlex.quote(str(context.params[name]))}"
        for option, name in options
        if context.get_parameter_source(name) is ParameterSource.COMMANDLINE
    )


def load_config(file: Path | None) -> "Config":
    """Return the configuration of a file, the defaults without one; end the command with all mistakes of the file."""
    from softarm.daemon.config.configuration import load
    from softarm.schemas.config import Config

    return Config() if file is None else load(file)


def prepared(file: Path | None, wires: bool, port: int | None = None) -> "Config":
    """Return a configuration that a daemon can start with; end the command with all problems otherwise.

    Args:
        file: The YAML file; None for the default values.
        wires: The robot is behind real interfaces, not simulated in this process.
        port: Port of the API, instead of the file's.
    """
    from softarm.daemon.runtime import preflight

    found = preflight.look(file, wires, port=port)
    if found.problems:
        fail("\n".join(found.problems))
    return found.config


def load_model(file: Path) -> "Model":
    """Return a model by its file or shipped name; end the command with a sentence if it is missing or invalid."""
    from softarm.simulator import model_file

    return model_file.load(file)


def flown_model(file: Path | None) -> "Model | None":
    """Return the model of a robot for the real control loop, or None without a file.

    Prints the effects that this loop cannot simulate. Ends the command with a sentence if the model is missing, invalid
    or has another number of links than the daemon expects.
    """
    from softarm.schemas.messages import BODY_NAMES

    if file is None:
        return None
    model = load_model(file)
    if model.arm.links != len(BODY_NAMES) - 1:
        fail(f"{file}: has {model.arm.links} links; the daemon flies an arm of {len(BODY_NAMES) - 1} marker sets")
    clock = [name for name in model.effects if name.startswith("clock.")]
    if clock:
        click.echo(f"{', '.join(clock)}: not simulated, since the real control loop runs here", err=True)
    return model


def write_json(file: Path | None, data: object) -> None:
    """Write the results to the file of --json, if there is one, as `write` does."""
    if file is not None:
        write(file, json.dumps(data, indent=1) + "\n")


def write(file: Path, text: str) -> None:
    """Write a text file and print its name."""
    write_bytes(file, text.encode())


def write_bytes(file: Path, content: bytes) -> None:
    """Write a binary file as `write` does."""
    files.write_bytes(file, content)
    click.echo(f"wrote {file}")


def check_places(*places: Path | None) -> None:
    """End the command with a sentence if the folder of a result is missing, before minutes of work."""
    for file in places:
        if file is not None and not file.parent.is_dir():
            fail(f"{file}: the folder {file.parent} does not exist; create it or choose another place")


def token_of(file: Path | None) -> str | None:
    """Return the API token from a file, or else from $SOFTARM_TOKEN, or None."""
    place, token = "$SOFTARM_TOKEN", os.environ.get("SOFTARM_TOKEN")
    remedy = "name the file of the daemon's api.token_file"
    if file is not None:
        place = f"--token-file {file}"
        try:
            token = file.read_text(encoding="utf-8").strip()
        except (OSError, UnicodeDecodeError) as error:
            fail(f"{place}: cannot be read ({error}); {remedy}")
    if token is not None and not (token.isascii() and token.isprintable()):
        fail(f"{place}: is no token; allowed are letters, digits and other printable ASCII characters; {remedy}")
    return token


WIDTH, WIDE = 80, 160  # of tables without a terminal; wide: with sentences
NO_VALUE = "-"
PATIENCE_S = 2.0  # a wait longer than this is announced

print_option = click.option("--json", "as_json", is_flag=True, help="Print JSON, for a script.")


def warn(*texts: str) -> None:
    """Print each text to standard error."""
    for text in texts:
        click.echo(text, err=True)


def print_json(answer: object) -> None:
    """Print an answer as JSON."""
    click.echo(json.dumps(answer, indent=1))


def clock(time: str) -> str:
    """Return an ISO time as local time of day, with the date unless it is today."""
    at = datetime.fromisoformat(time).astimezone()
    day = "" if at.date() == datetime.now(at.tzinfo).date() else f"{at:%Y-%m-%d} "
    return f"{day}{at:%H:%M:%S}.{at.microsecond // 1000:03d}"


def print_table(columns: Sequence[str], rows: Iterable[Sequence[str]], title: str = "", width: int = WIDTH) -> None:
    """Print rows of plain text, as wide as the terminal or `width` characters without one.

    A column of which every row has NO_VALUE is left out.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table, rows = Table(title=title), list(rows)
    shown = [k for k in range(len(columns)) if not rows or any(row[k] != NO_VALUE for row in rows)]
    for k in shown:
        table.add_column(columns[k], overflow="fold")
    for row in rows:
        table.add_row(*(Text(row[k]) for k in shown))
    Console(width=None if sys.stdout.isatty() else width).print(table)


def print_text(text: str) -> None:
    """Print sentences wrapped to the terminal."""
    from rich.console import Console

    Console().print(text, markup=False, highlight=False)


@contextmanager
def waiting(text: str) -> Iterator[None]:
    """Print the reason for a wait to standard error: at once on a terminal, elsewhere after two seconds."""
    from rich.console import Console

    from softarm.common.processes import later

    console = Console(stderr=True)
    if console.is_terminal:
        with console.status(text):
            yield
        return
    with later(PATIENCE_S, lambda: click.echo(f"{text} ...", err=True)):
        yield
