"""Stamps that are dates with a time of day (ISO 8601), as seconds: since 1970, of UTC where a time zone stands there.

Without a time zone they are taken as they stand: a recording has one clock, and only differences count.
"""

import math
from collections.abc import Callable, Sequence
from datetime import UTC, datetime

import numpy as np

from softarm.diagnosis.data.trials import Array, TrialError


def instant(cell: str) -> datetime | None:
    """A cell as a date and time; None where it is none. A number is none: 20261122 counts something."""
    text = cell.strip()
    if not (text[:4].isdigit() and ("T" in text or ":" in text or text.count("-") == 2)):
        return None
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        return None


def seconds(
    cells: Sequence[str], missing: Callable[[str | float], bool], place: Callable[[int], int], where: str
) -> tuple[Array, bool]:
    """Seconds of each cell [N], NaN where `missing` says so; and whether they have time zones.

    where: file and column; place: a row's index -> where people find it. Raises TrialError for a cell that is no
    instant, and where only some have a time zone.
    """
    found = np.full(len(cells), math.nan)
    zones: dict[bool, int] = {}  # whether there is a zone -> the first such cell
    for i, cell in enumerate(cells):
        if missing(cell):
            continue
        if (read := instant(cell)) is None:
            raise TrialError(
                f"{where}, row {place(i)}: {cell!r} is no date and time as the others are; repair that row"
            )
        zones.setdefault(read.tzinfo is not None, i)
        found[i] = (read if read.tzinfo else read.replace(tzinfo=UTC)).timestamp()
    if len(zones) > 1:
        raise TrialError(
            f"{where}: row {place(zones[True])} has a time zone ({cells[zones[True]].strip()}), row "
            f"{place(zones[False])} has none ({cells[zones[False]].strip()}); write all of them with one, or none"
        )
    return found, True in zones
