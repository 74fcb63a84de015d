"""Tables of text, as several verbs print them."""

from collections.abc import Iterable, Sequence


def print_table(columns: Sequence[str], rows: Iterable[Sequence[str]], title: str = "", width: int = 160) -> None:
    """Print rows of plain text; as wide as the terminal, or `width` characters where there is none."""
    import sys

    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(*columns, title=title)
    for row in rows:
        table.add_row(*map(Text, row))
    Console(width=None if sys.stdout.isatty() else width).print(table)
