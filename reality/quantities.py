"""Frozen dataclasses of physical quantities: each field has a default, a unit, bounds and a meaning, declared once."""

import dataclasses
import math
from typing import Any


def quantity(default: float, unit: str, low: float, high: float, meaning: str) -> Any:
    """Declare a number; `low` and `high` are allowed, and so is infinity where `high` is infinite."""
    return dataclasses.field(default=default, metadata={"unit": unit, "low": low, "high": high, "meaning": meaning})


class Checked:
    """Refuses what is out of bounds; the base of every group of quantities."""

    def __post_init__(self) -> None:
        """Raise ValueError with the quantity's name, the allowed range and what to do."""
        for field in dataclasses.fields(self):  # type: ignore[arg-type]
            value, bounds = getattr(self, field.name), field.metadata
            whole = field.type in (int, "int")
            if isinstance(value, bool) or not isinstance(value, int if whole else int | float):
                kind = "a whole number" if whole else "a number"
                raise ValueError(f"{type(self).__name__}.{field.name} is {value!r}; give {kind}")
            if not bounds["low"] <= value <= bounds["high"]:
                limit = f"{bounds['low']:g} to {bounds['high']:g}"
                raise ValueError(
                    f"{type(self).__name__}.{field.name} is {value:g}; allowed are {limit} "
                    f"({bounds['unit']}): choose a value in that range"
                )


def table(*groups: type[Checked]) -> str:
    """The quantities as a Markdown table, one row each, in order of declaration."""
    rows = ["| parameter | default | range | unit | meaning |", "|---|---|---|---|---|"]
    for group in groups:
        for field in dataclasses.fields(group):  # type: ignore[arg-type]
            facts = field.metadata
            limits = f"{facts['low']:g} .. {facts['high']:g}"
            name = f"{group.__name__}.{field.name}"
            rows.append(f"| `{name}` | {field.default:.4g} | {limits} | {facts['unit']} | {facts['meaning']} |")
    return "\n".join(rows) + "\n"


INF = math.inf
