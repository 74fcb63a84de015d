"""Conversion of stamps that are dates with a time of day (ISO 8601) to seconds since 1970 UTC.

A date without a time zone counts as UTC: a recording has one clock, and only differences matter.
"""

from datetime import UTC, datetime


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
