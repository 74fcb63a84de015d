"""Names of a recording's columns in a stage file, and their usual units."""

import re
from collections.abc import Mapping, Sequence

import numpy as np

from softarm.common.quantity import PURE
from softarm.diagnosis.describe.survey import Signal
from softarm.schemas.stage_model import StageKind

# Standard unit of a driven mass's input -> its column.
DRIVES = {"N": "force", "N m": "force", "A": "current", "V": "voltage"}


def natural(signal: Signal) -> tuple[object, ...]:
    """Return a key that sorts angle2 before angle10."""
    return tuple((0, int(part), "") if part.isdigit() else (1, 0, part) for part in re.split(r"(\d+)", signal.label))


def name_of(kind: StageKind, channel: str, standard: str, taken: Mapping[str, object]) -> str:
    """Return the name that a kind of stage gives to a column with this standard unit."""
    if channel in ("command", "base"):
        return "command" if channel == "command" else "position"
    if channel == "torque":
        return f"torque{len(taken) + 1}"
    if channel == "force":
        return DRIVES.get(standard, "force")
    if kind in ("pendulum", "chain"):
        name = "rate" if standard.endswith("/s") else "angle"
        return f"{name}{sum(each.startswith(name) for each in taken) + 1}"
    if standard in ("m", "rad", "counts"):
        return "position"
    if standard in ("m/s", "rad/s", "counts/s"):
        return "velocity"
    return "pressure" if standard == "kPa" else "value"


def links_of(torques: Sequence[Signal], angles: Sequence[Signal]) -> list[int] | None:
    """Return the link of each torque of a chain, from 1 on, or None if the headers do not show it.

    Torques of all links are in their order; fewer have the numbers of their angles.
    """
    if len(torques) == len(angles):
        return [*range(1, len(torques) + 1)]
    numbers, own = [_number(s) for s in angles], [_number(s) for s in torques]
    if len(set(numbers)) < len(numbers):
        numbers = [*range(1, len(numbers) + 1)]
    if len(set(own)) < len(own) or not set(own) <= set(numbers) - {None}:
        return None
    return [numbers.index(number) + 1 for number in own]


def _number(signal: Signal) -> int | None:
    """Return the last number in a header's name, or None without one."""
    found = re.findall(r"\d+", signal.header.name)
    return int(found[-1]) if found else None


def likely_unit(signal: Signal, standard: str) -> str:
    """Return the unit that a quantity usually has in such a range."""
    top = float(np.max(np.abs(signal.all)))
    if standard == "rad" and top > 2 * np.pi:
        return "deg" if top <= 720 else "counts"
    if standard == "m" and top > 5:
        return "mm"
    return {PURE: "1"}.get(standard, standard)
