"""Conversion of stamps that are dates with a time of day (ISO 8601) to seconds since 1970 UTC.

A date without a time zone counts as UTC: a recording has one clock, and only differences matter.
"""

import math
from collections.abc import Callable, Sequence
from datetime import UTC, datetime

import numpy as np

from softarm.diagnosis.data.trials import Array, TrialError


def instant(cell: str) -> datetime | None:
    """Return a cell as a date and time, or None if it is not one; a number such as 20261122 is not one."""
    text = cell.strip()
    if not (text[:4].isdigit() and ("T" in text or ":" in text or text.count("-") == 2)):
        return None
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        return None


def unix_s(moment: datetime) -> float:
    """Return a date and time in seconds since 1970 UTC."""
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def seconds(
    cells: Sequence[str], missing: Callable[[str | float], bool], place: Callable[[int], int], where: str
) -> tuple[Array, bool]:
    """Convert cells to seconds [N], and return whether they have time zones.

    A missing cell becomes NaN. For messages, `place` maps a row's index to its number in the file and `where` is file
    and column. Raises TrialError if a cell is not a date and time, or only some have a time zone.
    """
    found = np.full(len(cells), math.nan)
    zones: dict[bool, int] = {}  # whether there is a zone -> the first such cell
    for i, cell in enumerate(cells):
        if missing(cell):
            continue
        if (read := instant(cell)) is None:
            raise TrialError(
                f"{where}, row {place(i)}: {cell!r} is not a date and time like the others; repair that row"
            )
        zones.setdefault(read.tzinfo is not None, i)
        found[i] = unix_s(read)
    if len(zones) > 1:
        raise TrialError(
            f"{where}: row {place(zones[True])} has a time zone ({cells[zones[True]].strip()}), row "
            f"{place(zones[False])} has none ({cells[zones[False]].strip()}); write all with a time zone, or none"
        )
    return found, True in zones
