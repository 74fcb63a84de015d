"""Formatting of numbers, percentages, units and lists for reports."""

import math
from collections.abc import Iterable

# Unit -> smaller unit for small values, and the factor to it.
_SMALLER = {"s": ("ms", 1e3), "m": ("mm", 1e3), "m/s": ("mm/s", 1e3), "kg": ("g", 1e3)}
_SMALL = 0.1


def number(value: float, digits: int = 3) -> str:
    """Return a number with a count of significant digits, without trailing zeros; exponents only for extreme values.

    Infinity is an absent bound (`none`), NaN is `not known`.
    """
    if not math.isfinite(value):
        return "none" if math.isinf(value) else "not known"
    if value == 0:
        return "0"
    if not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}"
    text = f"{value:.{max(0, digits - 1 - math.floor(math.log10(abs(value))))}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def percent(share: float) -> str:
    """Return a share as a whole percentage."""
    if not math.isfinite(share):
        return "not known"
    if 0 < share < 0.005:
        return "under 1 %"
    return f"{round(100 * share)} %".replace("-0 %", "0 %")


def scaled(unit: str, largest: float) -> tuple[str, float]:
    """Return the display unit for values up to `largest`, and the factor to it."""
    smaller, factor = _SMALLER.get(unit, ("", 1.0))
    return (smaller, factor) if smaller and 0 < abs(largest) < _SMALL else ("" if unit in ("-", "1") else unit, 1.0)


def quantity(value: float, unit: str, digits: int = 2) -> str:
    """Return a value with its unit: `61 ms`, `0.31 kPa`, `0.2`."""
    shown, factor = scaled(unit, value)
    return f"{number(value * factor, digits)} {shown}".strip() if math.isfinite(value) else number(value)


def listed(items: Iterable[str], last: str = "and") -> str:
    """Return items as an enumeration: `a, b and c`."""
    *head, tail = items
    return f"{', '.join(head)} {last} {tail}" if head else tail
