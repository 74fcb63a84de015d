"""Numbers as people read them."""

import math
from collections.abc import Iterable

# Unit -> what its small values are shown in, and how many of these make one.
_SMALLER = {"s": ("ms", 1e3), "m": ("mm", 1e3), "m/s": ("mm/s", 1e3), "kg": ("g", 1e3)}
_SMALL = 0.1


def number(value: float, digits: int = 3) -> str:
    """A number with so many significant digits, trailing zeros left out, no exponent where it can be read without."""
    if not math.isfinite(value):
        return "none" if math.isinf(value) else "not known"  # infinite: a bound so far away that it binds nothing
    if value == 0:
        return "0"
    if not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}"
    text = f"{value:.{max(0, digits - 1 - math.floor(math.log10(abs(value))))}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def percent(share: float) -> str:
    """A share as a whole percentage."""
    if not math.isfinite(share):
        return "not known"
    if 0 < share < 0.005:
        return "under 1 %"
    return f"{round(100 * share)} %".replace("-0 %", "0 %")


def scaled(unit: str, largest: float) -> tuple[str, float]:
    """The unit that values up to `largest` are shown in, and what they are multiplied by."""
    smaller, factor = _SMALLER.get(unit, ("", 1.0))
    return (smaller, factor) if smaller and 0 < abs(largest) < _SMALL else ("" if unit in ("-", "1") else unit, 1.0)


def quantity(value: float, unit: str, digits: int = 2) -> str:
    """A value with its unit: `61 ms`, `0.31 kPa`, `0.2`."""
    shown, factor = scaled(unit, value)
    return f"{number(value * factor, digits)} {shown}".strip() if math.isfinite(value) else number(value)


def listed(items: Iterable[str], last: str = "and") -> str:
    """`a, b and c`."""
    *head, tail = items
    return f"{', '.join(head)} {last} {tail}" if head else tail
