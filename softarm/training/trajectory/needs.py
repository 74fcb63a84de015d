"""Smallest change of one quantity of the robot that brings a missed target into reach, by bisection."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from softarm.schemas.config import RailLimits
from softarm.schemas.model import Model
from softarm.schemas.robot import PRESSURE_MAX_KPA, RAIL_LIMIT_M, RAIL_TRAVEL_M
from softarm.training.trajectory.ceiling import Bounds, Ceiling, search
from softarm.training.trajectory.problem import Array

LEVELS = 5  # of the bisection: a 32nd of a quantity's range
DRIVE = "rail.acceleration_limit"
NOW = RailLimits()

Robot = tuple[Model, Bounds]


class Quantity(NamedTuple):
    """Quantity of the robot that can be changed alone."""

    unit: str
    now: float
    most: float
    robot: Callable[[Model, float], Robot]


class Need(NamedTuple):
    """Need of a target: by quantity, the value that reaches it, or None if the largest one does not."""

    target_m: Array  # [2]
    closest_m: float  # today
    values: Mapping[str, float | None]
    closest_without_law_m: float  # with the cart within its limit until then, but no braking clamp


def _limits(**values: float) -> Bounds:
    # Values beyond the schema's bounds, which are those of today's rail.
    return Bounds(NOW.model_copy(update=values))


def _longer(model: Model, half_m: float) -> Robot:
    cart = model.cart.model_copy(update={"travel_m": RAIL_TRAVEL_M + half_m - RAIL_LIMIT_M})
    return model.model_copy(update={"cart": cart}), _limits(position_min_m=-half_m, position_max_m=half_m)


def _stronger(model: Model, acceleration_m_s2: float) -> Robot:
    """Return a robot with a faster drive; the law's worst acceleration grows as much."""
    surge = NOW.surge_m_s2 + acceleration_m_s2 - NOW.acceleration_max_m_s2
    effects = model.effects | {DRIVE: {"acceleration": acceleration_m_s2}}
    return model.model_copy(update={"effects": effects}), _limits(surge_m_s2=surge)


QUANTITIES = {
    "rail half-length": Quantity("m", RAIL_LIMIT_M, 0.41, _longer),
    "pressure": Quantity("kPa", PRESSURE_MAX_KPA, 36.0, lambda model, most: (model, Bounds(pressure_max_kpa=most))),
    "cart speed": Quantity(
        "m/s", NOW.velocity_max_m_s, 2.0, lambda model, most: (model, _limits(velocity_max_m_s=most))
    ),
    "drive acceleration": Quantity("m/s^2", NOW.acceleration_max_m_s2, 14.0, _stronger),
    "guaranteed braking": Quantity(
        "m/s^2", NOW.braking_m_s2, 6.0, lambda model, most: (model, _limits(braking_m_s2=most))
    ),
}


def of_missed(
    targets_m: Array, model: Model | None = None, seed: int = 0, on_search: Callable[[str], None] = lambda doing: None
) -> list[Need]:
    """Return what each target [G, 2] needs that is missed from the middle of the rail.

    The search gives upper bounds: a better open-loop command may need less. `on_search` receives the quantity in work.
    """
    model = model or Model()

    def searched(targets: Array, bounds: Bounds, robot: Model, doing: str) -> Ceiling:
        on_search(doing)
        return search(targets, 0.0, robot, seed, bounds=bounds)

    today = searched(targets_m, Bounds(), model, "today")
    missed = np.flatnonzero(np.isnan(today.reached_s))
    if not missed.size:
        return []
    targets = targets_m[missed]
    values: dict[str, list[float | None]] = {}
    for name, quantity in QUANTITIES.items():

        def reached(value: float, which: list[int], name: str = name, quantity: Quantity = quantity) -> list[bool]:
            robot, bounds = quantity.robot(model, value)
            found = searched(targets[which], bounds, robot, name)
            return [bool(hit) for hit in np.isfinite(found.reached_s)]

        values[name] = bisected(quantity.now, quantity.most, len(targets), reached)
    free = searched(targets, Bounds(guarded=False), model, "no braking law").closest_m
    return [
        Need(target_m, float(today.closest_m[row]), {name: each[i] for name, each in values.items()}, float(free[i]))
        for i, (row, target_m) in enumerate(zip(missed, targets, strict=True))
    ]


def figures(found: Sequence[Need]) -> dict[str, Any]:
    """Return needs and quantities as JSON types."""
    rows = [need._asdict() | {"target_m": [round(float(each), 6) for each in need.target_m]} for need in found]
    return {"rows": rows, "quantities": {name: each[:3] for name, each in QUANTITIES.items()}}


def lines(found: Mapping[str, Any]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return the table of `figures`: its head with the targets, and a row per quantity."""
    rows = [("nearest today (m)", *(f"{row['closest_m']:.3f}" for row in found["rows"]))]
    for name, (unit, now, most) in found["quantities"].items():
        values = (row["values"][name] for row in found["rows"])
        needed = (f"not by {most:g}" if value is None else f"{value:.3g}" for value in values)
        rows.append((f"{name} ({unit}), now {now:g}", *needed))
    rows.append(("nearest without braking law (m)", *(f"{row['closest_without_law_m']:.3f}" for row in found["rows"])))
    targets = (row["target_m"] for row in found["rows"])
    return ("needed for y, z (m)", *(f"{y:.2f}, {z:.2f}" for y, z in targets)), rows


def bisected(
    now: float, most: float, targets: int, reached: Callable[[float, list[int]], list[bool]]
) -> list[float | None]:
    """Return the smallest value up to `most` that reaches each target, or None.

    `reached` takes a value and the targets to search with it; targets whose ranges are alike share a search.
    """
    everyone = list(range(targets))
    possible = reached(most, everyone)
    low, high = [now] * targets, [most] * targets
    for _ in range(LEVELS):
        middle = [0.5 * (low[i] + high[i]) for i in everyone]
        for value in sorted({middle[i] for i in everyone if possible[i]}):
            which = [i for i in everyone if possible[i] and middle[i] == value]
            for i, hit in zip(which, reached(value, which), strict=True):
                (high if hit else low)[i] = value
    return [high[i] if possible[i] else None for i in everyone]
