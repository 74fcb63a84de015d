"""Frozen dataclasses of physical quantities: each field has a default, a unit, bounds and a meaning, declared once."""

import dataclasses
import math
from typing import Any

from softarm.common.quantity import Quantity


def quantity(default: float, unit: str, low: float, high: float, meaning: str) -> Any:
    """Declare a number, a whole one where the default is; `low` and `high` are allowed."""
    facts = Quantity(unit=unit, low=low, high=high, whole=isinstance(default, int), default=default, meaning=meaning)
    return dataclasses.field(default=default, metadata={"quantity": facts})


def of(group: type) -> dict[str, Quantity]:
    """The quantities of a group by name, in order of declaration."""
    return {field.name: field.metadata["quantity"] for field in dataclasses.fields(group)}


class Checked:
    """Refuses what is out of bounds; the base of every group of quantities."""

    def __post_init__(self) -> None:
        """Raise ValueError with the quantity's name, the allowed range and what to do."""
        for name, allowed in of(type(self)).items():
            if not allowed.takes(value := getattr(self, name)):
                raise ValueError(f"{type(self).__name__}.{name} {allowed.complaint(value)}; choose another")


def table(*groups: type[Checked]) -> str:
    """The quantities as a Markdown table, one row each, in order of declaration."""
    rows = ["| parameter | default | range | unit | meaning |", "|---|---|---|---|---|"]
    for group in groups:
        for name, it in of(group).items():
            limits = f"{it.low:g} .. {it.high:g}"
            rows.append(f"| `{group.__name__}.{name}` | {it.default:.4g} | {limits} | {it.unit} | {it.meaning} |")
    return "\n".join(rows) + "\n"


INF = math.inf
