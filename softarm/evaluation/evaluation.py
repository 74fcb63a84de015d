"""Success of one policy at the paper's 54 targets, flown by the real control loop on the simulated robot."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import TypedDict

from softarm.evaluation.runner import Runner, load
from softarm.schemas import flights
from softarm.schemas.config import Config
from softarm.schemas.flights import Flight, Scenario
from softarm.schemas.model import Model

FLIGHTS = len(flights.grid())


class Target(TypedDict):
    """One flight to one target."""

    y: float
    z: float
    start: float
    reached: bool
    time_s: float
    closest_m: float


class Evaluation(TypedDict):
    """The result of one policy, as `softarm evaluate --json` writes it."""

    policy: str
    success: dict[str, float]  # share of flights that reached their target: in_range, above, all
    max_tip_z_m: float
    max_cart_m: float
    real_time_factor: float
    targets: list[Target]


def evaluate(
    name: str,
    config: Config,
    model: Model | None = None,
    on_flight: Callable[[], None] = lambda: None,
    file: Path | None = None,
) -> Evaluation:
    """Fly every target from rest at every cart start.

    Args:
        name: Name of the policy.
        config: Configuration of the control loop.
        model: Model of the simulated robot; None for the seed's.
        on_flight: Called after each flight.
        file: ONNX file of the policy; None for the policy that the registry has under this name.

    Raises:
        PolicyError: The policy cannot be loaded.
        RuntimeError: The control loop refuses to arm.
    """
    policy = load(file or name, config)
    runner, scenarios = Runner(policy, model, config), flights.grid()
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
