"""Ceiling of success: a cross-entropy search over open-loop commands, which gives a lower bound.

The search uses only the tip's smallest distance, no gradients, costs or references. It shares simulator and braking
clamp with planners and policies, so a target that all of them miss is likely out of reach.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from softarm.schemas.config import RailLimits
from softarm.schemas.model import Model
from softarm.schemas.robot import PRESSURE_MAX_KPA, PRESSURE_MIN_KPA, RAIL_LIMIT_M, RAIL_TRAVEL_M
from softarm.training.task.reach import ReachTask
from softarm.training.trajectory.problem import Array, Rollouts, interpolation

POPULATION, ELITES, ROUNDS = 96, 12, 40
SMOOTH = 0.15  # share of the old mean and spread that a round keeps
SPREAD_LEAST = 0.02  # of the range, so that the population keeps searching


class Bounds(NamedTuple):
    """Limits of a search; by default those of the robot."""

    limits: RailLimits = RailLimits()
    pressure_max_kpa: float = PRESSURE_MAX_KPA
    guarded: bool = True  # whether the braking clamp acts


class Ceiling(NamedTuple):
    """Best result of the search, one entry per target."""

    closest_m: Array  # [G]
    reached_s: Array  # [G], time of the smallest distance; NaN for a missed target


def search(
    targets_m: Array,
    cart_start_m: float = 0.0,
    model: Model | None = None,
    seed: int = 0,
    on_round: Callable[[], None] = lambda: None,
    bounds: Bounds | None = None,
) -> Ceiling:
    """Search commands for every target [G, 2] from a straight, vented arm at rest; at the actuators' full ranges."""
    bounds = bounds or Bounds()
    task, rng = ReachTask(), np.random.default_rng(seed)
    targets, steps = len(targets_m), task.episode_steps
    spread_out = interpolation(steps)
    knots = spread_out.shape[1]
    rollouts = Rollouts(model, limits=bounds.limits)
    # Unit commands: -1 .. 1 is the actuators' range.
    mean = np.zeros((targets, knots, 2), dtype=np.float32)
    spread = np.full_like(mean, 0.7)
    wanted = np.repeat(targets_m, POPULATION, axis=0)
    closest, when = np.full(targets, np.inf, dtype=np.float32), np.zeros(targets)
    best = mean.copy()
    for _ in range(ROUNDS):
        noise = rng.standard_normal((targets, POPULATION, knots, 2), dtype=np.float32)
        tried = np.clip(mean[:, None] + spread[:, None] * noise, -1.0, 1.0)
        tried[:, 0] = best
        near, step = _fly(rollouts, bounds, spread_out, tried.reshape(-1, knots, 2), wanted, cart_start_m)
        near, step = near.reshape(targets, POPULATION), step.reshape(targets, POPULATION)
        order = near.argsort(axis=1)[:, :ELITES]
        elite = np.take_along_axis(tried, order[..., None, None], axis=1)
        mean = SMOOTH * mean + (1 - SMOOTH) * elite.mean(axis=1)
        spread = np.maximum(SMOOTH * spread + (1 - SMOOTH) * elite.std(axis=1), SPREAD_LEAST)
        first, everyone = order[:, 0], np.arange(targets)
        better = near[everyone, first] < closest
        closest = np.where(better, near[everyone, first], closest)
        when = np.where(better, step[everyone, first], when)
        best = np.where(better[:, None, None], elite[:, 0], best)
        on_round()
    reached_s = np.where(closest < task.success_radius_m, when / task.rate_hz, np.nan)
    return Ceiling(closest, reached_s.astype(np.float32))


def _fly(
    rollouts: Rollouts, bounds: Bounds, spread_out: Array, knots: Array, targets_m: Array, cart_start_m: float
) -> tuple[Array, NDArray[np.int64]]:
    """Return each robot's smallest distance with its cart inside the limit, and the step of it, [R]."""
    high = np.array((bounds.limits.velocity_max_m_s, bounds.pressure_max_kpa), dtype=np.float32)
    low = np.array((-high[0], PRESSURE_MIN_KPA), dtype=np.float32)
    commands = low + (np.tensordot(spread_out, knots, (1, 1)) + 1.0) * (0.5 * (high - low))
    start = np.full(len(knots), cart_start_m, dtype=np.float32)
    motion = rollouts.fly(commands.astype(np.float32), start, guarded=bounds.guarded)
    distance = motion.distance_m(targets_m, bounds.limits.position_max_m)
    return distance.min(axis=0), distance.argmin(axis=0)


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
