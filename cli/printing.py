"""What verbs print that is more than a line: wrapped to the terminal, without colours or markup of rich's own."""

import sys
from collections.abc import Iterable, Sequence
from datetime import datetime

WIDTH = 80  # where there is no terminal


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

    Console().print(text, markup=False, highlight=False)
