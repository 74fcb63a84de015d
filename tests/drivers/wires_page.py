"""Tables and test vectors of docs/reference/wires.md."""

import csv
import re
from pathlib import Path

REFERENCE = Path(__file__).parents[2] / "docs" / "reference"
PAGE = (REFERENCE / "wires.md").read_text(encoding="utf-8")


def table(*columns: str) -> list[list[str]]:
    """Return the cells of the only table of the page with these columns."""
    [rows] = re.findall(rf"^\| {re.escape(' | '.join(columns))} \|\n\|[-|]+\n((?:\|.*\n)+)", PAGE, re.MULTILINE)
    return [[cell.strip(" `") for cell in line.strip("|").split("|")] for line in rows.splitlines()]


def vectors(name: str) -> list[list[str]]:
    """Return the rows of a file with test vectors."""
    with (REFERENCE / "vectors" / name).open(newline="") as lines:
        return list(csv.reader(lines))[1:]
