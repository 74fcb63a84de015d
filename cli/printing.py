"""What verbs print that is more than a line: wrapped to the terminal, without colours or markup of rich's own."""

import json
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime

import click

from softarm.cli.words import in_commands

WIDTH = 80  # where there is no terminal
PATIENCE_S = 2.0  # nobody waits longer without a word

print_option = click.option("--json", "as_json", is_flag=True, help="Print JSON, for a script.")


def warn(*texts: str) -> None:
    """Print each to standard error."""
    for text in texts:
        click.echo(text, err=True)


def print_json(answer: object) -> None:
    """Print what --json asks for."""
    click.echo(json.dumps(answer, indent=1))


def clock(time: str) -> str:
    """When something happened, by this machine's wall: the time of day, before today with its date."""
    at = datetime.fromisoformat(time).astimezone()
    day = "" if at.date() == datetime.now(at.tzinfo).date() else f"{at:%Y-%m-%d} "
    return f"{day}{at:%H:%M:%S}.{at.microsecond // 1000:03d}"


def print_table(columns: Sequence[str], rows: Iterable[Sequence[str]], title: str = "", width: int = WIDTH) -> None:
    """Print rows of plain text; as wide as the terminal, or `width` characters where there is none."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(*columns, title=title)
    for row in rows:
        table.add_row(*map(Text, row))
    Console(width=None if sys.stdout.isatty() else width).print(table)


def print_text(text: str) -> None:
    """Print sentences, wrapped between words."""
    from rich.console import Console

    Console().print(in_commands(text), markup=False, highlight=False)


@contextmanager
def waiting(text: str) -> Iterator[None]:
    """Say on standard error what is waited for: at once on a terminal, else once it has taken two seconds."""
    from rich.console import Console

    console = Console(stderr=True)
    if console.is_terminal:
        with console.status(text):
            yield
        return
    later = threading.Timer(PATIENCE_S, click.echo, (f"{text} ...",), {"err": True})
    later.daemon = True
    later.start()
    try:
        yield
    finally:
        later.cancel()


@contextmanager
def told_how_it_goes() -> Iterator[Callable[[str], None]]:
    """A line on standard error that says how it goes: in place on a terminal, else anew every two seconds."""
    from rich.console import Console

    console = Console(stderr=True)
    if console.is_terminal:
        with console.status("") as status:
            yield lambda text: status.update(text)
        return
    due = time.monotonic() + PATIENCE_S

    def show(text: str) -> None:
        nonlocal due
        if (now := time.monotonic()) >= due:
            due = now + PATIENCE_S
            click.echo(text, err=True)

    yield show
