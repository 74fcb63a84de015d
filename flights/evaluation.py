"""How good is a policy? The paper's 54 targets, through the daemon's own tick on the simulated robot."""

import time
from collections.abc import Callable
from typing import TypedDict

from softarm.daemon.shell.offline import Flight, Lockstep
from softarm.policies import registry
from softarm.schemas.config import Config
from softarm.schemas.goals import TEST_TARGETS, TRAINED_Z_MAX_M
from softarm.schemas.model import Model

CART_STARTS_M = (0.0, 0.1, 0.2)
FLIGHTS = len(TEST_TARGETS) * len(CART_STARTS_M)


class Target(TypedDict):
    """One flight."""

    y: float
    z: float
    start: float
    reached: bool
    time_s: float
    closest_m: float


class Success(TypedDict):
    """Shares of flights that reached their target."""

    in_range: float
    above: float
    all: float


class Evaluation(TypedDict):
    """What `softarm evaluate --json` writes."""

    policy: str
    success: Success
    max_tip_z_m: float
    max_cart_m: float
    real_time_factor: float
    targets: list[Target]


def evaluate(
    name: str, config: Config, model: Model | None = None, on_flight: Callable[[], None] | None = None
) -> Evaluation:
    """Fly every target from rest at every cart start.

    Raises PolicyError for an unknown policy, RuntimeError when the daemon would not arm.
    """
    daemon = Lockstep(config, registry.load(name, config.policies), model)
    daemon.arm()  # the simulator's compilation stays out of the clock
    flights: list[Flight] = []
    started = time.perf_counter()
    for goal in TEST_TARGETS:
        for start in CART_STARTS_M:
            flights.append(daemon.fly(goal, start))
            if on_flight is not None:
                on_flight()
    wall_s = time.perf_counter() - started
    starts = CART_STARTS_M * len(TEST_TARGETS)
    targets = [_target(flight, start) for flight, start in zip(flights, starts, strict=True)]
    return Evaluation(
        policy=name,
        success=Success(
            in_range=_share(targets, lambda z: z <= TRAINED_Z_MAX_M),
            above=_share(targets, lambda z: z > TRAINED_Z_MAX_M),
            all=_share(targets, lambda z: True),
        ),
        max_tip_z_m=max(flight.max_tip_z_m for flight in flights),
        max_cart_m=max(flight.max_cart_m for flight in flights),
        real_time_factor=sum(flight.ticks for flight in flights) / config.control.rate_hz / wall_s,
        targets=targets,
    )


def _target(flight: Flight, start_m: float) -> Target:
    status = flight.status
    assert status.goal is not None
    return Target(
        y=status.goal.y_m,
        z=status.goal.z_m,
        start=start_m,
        reached=flight.reached,
        time_s=status.time_s,
        closest_m=status.closest_m if status.closest_m is not None else float("inf"),
    )


def _share(targets: list[Target], chosen: Callable[[float], bool]) -> float:
    part = [target["reached"] for target in targets if chosen(target["z"])]
    return sum(part) / len(part)
