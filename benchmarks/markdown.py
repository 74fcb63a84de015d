"""Markdown tables of the pages."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

Read = Callable[[str], Mapping[str, Any]]  # the name of a stored result -> what it holds


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table with a head and rows. Raises ValueError for a row that does not fit the head."""
    lines = [_line(head), "|" + "---|" * len(head)]
    for row in rows:
        if len(row) != len(head):
            raise ValueError(f"a row of {len(row)} cells in a table of {len(head)} columns: {row}")
        lines.append(_line(row))
    return "\n".join(lines) + "\n"


def _line(cells: Sequence[str]) -> str:
    return "|" + "|".join(f" {cell} " if cell else " " for cell in cells) + "|"
