"""Declaration of physical quantities as dataclass fields with a default, a unit, bounds and a meaning."""

import dataclasses
import math
from typing import Any

from softarm.common.quantity import Quantity


def quantity(default: float, unit: str, low: float, high: float, meaning: str) -> Any:
    """Declare a quantity; both bounds are allowed values, and a whole default allows whole numbers only."""
    facts = Quantity(unit=unit, low=low, high=high, whole=isinstance(default, int), default=default, meaning=meaning)
    return dataclasses.field(default=default, metadata={"quantity": facts})


def of(group: type) -> dict[str, Quantity]:
    """Return the quantities of a group by name, in order of declaration."""
    return {field.name: field.metadata["quantity"] for field in dataclasses.fields(group)}


class Checked:
    """Base of every group of quantities; rejects values outside their bounds."""

    def __post_init__(self) -> None:
        """Raise ValueError with the quantity's name, the allowed range and what to do."""
        for name, allowed in of(type(self)).items():
            if not allowed.takes(value := getattr(self, name)):
                raise ValueError(f"{type(self).__name__}.{name} {allowed.complaint(value)}; choose another")


def table(*groups: type[Checked]) -> str:
    """Return the quantities as a Markdown table, one row each, in order of declaration."""
    rows = ["| parameter | default | range | unit | meaning |", "|---|---|---|---|---|"]
    for group in groups:
        for name, it in of(group).items():
            limits = f"{it.low:g} .. {it.high:g}"
            rows.append(f"| `{group.__name__}.{name}` | {it.default:.4g} | {limits} | {it.unit} | {it.meaning} |")
    return "\n".join(rows) + "\n"


INF = math.inf
