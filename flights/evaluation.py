"""How good is a policy? The paper's 54 targets, through the daemon's own tick on the simulated robot."""

import time
from collections.abc import Callable
from typing import TypedDict

from softarm.flights.runner import Runner
from softarm.policies import registry
from softarm.schemas import flights
from softarm.schemas.config import Config
from softarm.schemas.flights import Flight, Scenario
from softarm.schemas.model import Model

FLIGHTS = len(flights.grid())


class Target(TypedDict):
    """One flight."""

    y: float
    z: float
    start: float
    reached: bool
    time_s: float
    closest_m: float


class Evaluation(TypedDict):
    """What `softarm evaluate --json` writes."""

    policy: str
    success: dict[str, float]  # shares of flights that reached their target: in_range, above, all
    max_tip_z_m: float
    max_cart_m: float
    real_time_factor: float
    targets: list[Target]


def evaluate(
    name: str, config: Config, model: Model | None = None, on_flight: Callable[[], None] = lambda: None
) -> Evaluation:
    """Fly every target from rest at every cart start.

    Raises PolicyError for an unknown policy, RuntimeError when the daemon would not arm.
    """
    runner, scenarios = Runner(registry.load(name, config.policies), model, config), flights.grid()
    flown: list[Flight] = []
    started = time.perf_counter()
    for scenario in scenarios:
        flown.append(runner.fly(scenario))
        on_flight()
    wall_s = time.perf_counter() - started
    success = flights.shares([flight.reached for flight in flown], flights.heights(scenarios))
    return Evaluation(
        policy=name,
        success=success._asdict(),
        max_tip_z_m=max(flight.max_tip_z_m for flight in flown),
        max_cart_m=max(flight.max_cart_m for flight in flown),
        real_time_factor=sum(flight.ticks for flight in flown) / config.control.rate_hz / wall_s,
        targets=[_target(scenario, flight) for scenario, flight in zip(scenarios, flown, strict=True)],
    )


def _target(scenario: Scenario, flight: Flight) -> Target:
    closest = flight.status.closest_m
    return Target(
        y=scenario.goal.y_m,
        z=scenario.goal.z_m,
        start=scenario.cart_start_m,
        reached=flight.reached,
        time_s=flight.status.time_s,
        closest_m=float("inf") if closest is None else closest,
    )
