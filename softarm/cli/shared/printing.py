"""Printing of tables, wrapped text and progress for verbs."""

import json
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime

import click

WIDTH = 80  # where there is no terminal
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
    """Print rows of plain text, as wide as the terminal or `width` characters without one."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(*columns, title=title)
    for row in rows:
        table.add_row(*map(Text, row))
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
