"""Attack the safety filter: can any policy drive the cart beyond its limits, on any robot?

Worlds are drawn at random: ramps of 2 to 8 m/s^2, latencies up to 100 ms, payloads up to 100 g, axis readings 0 to
150 ms old, skipped ticks. In each world the limits are set to the measured behaviour of that robot. Then policies of
several kinds attack it, and a search breeds the worst ones further. `--through law` simulates hundreds of robots of
a world at once against the filter's law; `--through tick` runs one at a time through the daemon's whole tick.
Skipped ticks count as ticks.
"""

import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks import results
from softarm.common import batch
from softarm.common.batch import Workers, workers_options
from softarm.common.processes import bar
from softarm.daemon.control.records import Mode
from softarm.daemon.runtime.offline import Lockstep
from softarm.drivers.bodies.base import Body
from softarm.drivers.bodies.simulated import SimulatedBody
from softarm.evaluation.runner import FLIGHTS
from softarm.policies import registry
from softarm.policies.base import Array, PolicySpec
from softarm.schemas import flights
from softarm.schemas.config import Config, DryveRail, Limits, RailLimits
from softarm.schemas.goals import Goal
from softarm.schemas.messages import RailReading
from softarm.schemas.policy import Observation
from softarm.schemas.robot import RAIL_EXCURSION_M, RAIL_LIMIT_M, RAIL_TRAVEL_M
from validation.adversary_batch import (
    FLOWN_TICKS,
    GENERATIONS,
    KINDS,
    PATCHED,
    Genes,
    Policies,
    World,
    attack,
    measured,
)

ROBOTS = 256  # simulated at once in a world
MEASURED_ROBOTS = 64
LOOK_NS = 8_500_000  # interval of the axis readings
TICKS_OF_A_WORLD = 1200  # with --through tick
FARTHEST_GOAL = Goal("reach", 0.59, 0.51)  # inside the workspace but out of reach
AT_THE_STOP_M = 0.0005
STALE_S = 0.25  # the failsafe ignores younger readings, so that the filter is tested
COST_POLICIES = ("reach", "reach-wide", "reach-robust", "trajectory")
COST_WORLDS = {
    "as it is": {},
    "ramp 2 m/s^2": {"ramp_m_s2": 2.0},
    "ramp 4 m/s^2": {"ramp_m_s2": 4.0},
    "ramp 8 m/s^2": {"ramp_m_s2": 8.0},
    "payload 50 g": {"payload_kg": 0.05},
    "payload 100 g": {"payload_kg": 0.1},
    "latency 67 ms": {"latency_s": 0.067},
    "latency 100 ms": {"latency_s": 0.1},
    "readings 30 ms old": {"age_s": 0.03},
    "readings 75 ms old": {"age_s": 0.075},
    "readings 150 ms old": {"age_s": 0.15},
}


class LateBody:
    """Body whose axis shows an old position, with its farthest true position from the middle since it was placed.

    Args:
        body: The body; every other attribute is its own.
        age_s: Age of the axis readings.
        pieces: Splits a step's duration, ns, at the moments at which the axis and the position are looked at.
        fresh: Whether the stamps of the readings hide their age.
    """

    def __init__(self, body: Body, age_s: float, pieces: Callable[[int], Iterable[int]], fresh: bool = False) -> None:
        self._body, self._age_ns, self._pieces, self._fresh = body, round(age_s * 1e9), pieces, fresh
        self._begin()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._body, name)

    def _begin(self) -> None:
        self._read = deque([self._body.encoder()])
        self.farthest_m = abs(self._body.truth.cart_position_m)

    def step(self, cart_velocity_m_s: float, pressure_kpa: float, duration_ns: int) -> None:
        """Advance the body as `Body.step` does."""
        for piece_ns in self._pieces(duration_ns):
            self._body.step(cart_velocity_m_s, pressure_kpa, piece_ns)
            self._read.append(replace(self._body.encoder(), t_receive_ns=self._body.now_ns))
            self.farthest_m = max(self.farthest_m, abs(self._body.truth.cart_position_m))
        while len(self._read) > 1 and self._read[1].t_receive_ns <= self._body.now_ns - self._age_ns:
            self._read.popleft()

    def place(self, cart_position_m: float) -> None:
        """Put the cart somewhere as `Body.place` does."""
        self._body.place(cart_position_m)
        self._begin()

    def encoder(self) -> RailReading:
        """Return the delayed axis reading."""
        return replace(self._read[0], t_receive_ns=self._body.now_ns) if self._fresh else self._read[0]


def late(world: World) -> LateBody:
    """Return the simulated robot of a world, whose readings have old stamps."""
    return LateBody(SimulatedBody(world.model), world.age_s, looks)


def looks(duration_ns: int) -> Iterator[int]:
    """Split a duration into intervals of LOOK_NS and a shorter rest."""
    for begin_ns in range(0, duration_ns, LOOK_NS):
        yield min(LOOK_NS, duration_ns - begin_ns)


class Mean:
    """One policy of the batch, run by the daemon."""

    spec = PolicySpec("mean", "tries to throw the cart off the rail")

    def __init__(self, kind: int, genes: Genes | None, rng: np.random.Generator) -> None:
        self._policies = Policies(1, rng, genes)
        self._policies.kind[:] = kind

    def reset(self) -> None:
        """Keep the state, since the policy continues across goals."""

    def step(self, observation: Array, goal: Array) -> Array:
        """Return the next command of this policy."""
        seen = Observation(*observation.tolist())
        velocity, pressure = self._policies.act(np.array([seen.cart_position_m]), np.array([seen.tip_vy_m_s]))
        return np.array([velocity[0], pressure[0]], dtype=np.float32)


def configured(world: World, limits: RailLimits) -> Config:
    """Return the daemon's configuration for a robot."""
    limits = limits.model_copy(update={"acceleration_max_m_s2": max(limits.acceleration_max_m_s2, world.ramp_m_s2)})
    drive = DryveRail(acceleration_m_s2=world.ramp_m_s2, quick_stop_m_s2=world.ramp_m_s2)
    config = Config()
    return config.model_copy(
        update={
            "limits": Limits(rail=limits),
            "drivers": config.drivers.model_copy(update={"rail": drive}),
            "failsafe": config.failsafe.model_copy(update={"rail_stale_s": STALE_S}),
        }
    )


def attack_by_ticks(world: World, seed: int) -> dict[str, Any]:
    """Attack a world through the whole tick, one robot per kind of policy, and return the figures."""
    rng = np.random.default_rng(seed)
    limits = measured(world, MEASURED_ROBOTS, rng)
    config, stops = configured(world, limits), Counter[str]()
    farthest, ticks = {}, 0
    for kind, name in enumerate(KINDS):
        body = late(world)
        daemon = Lockstep(config, Mean(kind, Genes.draw(rng, 1) if kind == 2 else None, rng), body=body)
        daemon.arm()
        ticks += _throw(daemon, world, rng, stops)
        farthest[name] = body.farthest_m
    return {
        "world": world.__dict__,
        "limits": {key: round(getattr(limits, key), 3) for key in PATCHED},
        "seed": seed,
        "robot_ticks": ticks,
        "farthest_m": farthest,
        "beyond_m": max(farthest.values()) - RAIL_LIMIT_M,
        "flights": len(KINDS),
        "stops": dict(stops),
    }


def _throw(daemon: Lockstep, world: World, rng: np.random.Generator, stops: Counter[str]) -> int:
    ticks = 0
    while ticks < TICKS_OF_A_WORLD // len(KINDS):
        outputs = daemon.tick(daemon.request("goal", FARTHEST_GOAL))
        while outputs.goal.state == "running" and ticks < TICKS_OF_A_WORLD // len(KINDS):
            skipped = int(rng.integers(1, world.skipped_max + 1)) if rng.random() < world.skips else 0
            daemon.skip(skipped)
            outputs = daemon.tick()
            ticks += 1 + skipped
        if outputs.mode is not Mode.ARMED:
            stops.update(event.name for event in outputs.events if event.response != "warn")
            while outputs.mode is Mode.STOPPING:  # the arm brakes, settles and is armed again
                outputs = daemon.tick()
                ticks += 1
            daemon.tick(daemon.request("acknowledge"))
            daemon.arm()
    return ticks


def _attacked(through: str, seed: int) -> dict[str, Any]:
    world = World.draw(np.random.default_rng((seed, 1)))
    return attack(world, ROBOTS, seed) if through == "law" else attack_by_ticks(world, seed)


def cost(policies: Iterable[str], step: Callable[[], None]) -> dict[str, dict[str, float]]:
    """Return the share of the paper's targets that each policy reaches, by world, with limits measured there."""
    table: dict[str, dict[str, float]] = {}
    for name, changes in COST_WORLDS.items():
        nominal = {"ramp_m_s2": 6.0, "latency_s": 1 / 30, "payload_kg": 0.0, "age_s": 0.0}
        world = World(**{**nominal, **changes}, skips=0.0, skipped_max=1)
        limits = measured(world, MEASURED_ROBOTS, np.random.default_rng(0)) if changes else RailLimits()
        table[name] = {key: round(getattr(limits, key), 2) for key in ("braking_m_s2", "drag_m_s")}
        for policy in policies:
            daemon = Lockstep(configured(world, limits), registry.load(policy), body=late(world))
            reached = 0
            for scenario in flights.grid():
                reached += daemon.fly(scenario.goal, scenario.cart_start_m).reached
                step()
            table[name][policy] = reached / FLIGHTS
    return table


def summed(found: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the totals over all worlds, and the worlds where the cart came farthest."""
    beyond = [each["beyond_m"] for each in found]
    kinds = (*KINDS, "search")
    return {
        "worlds": len(found),
        "flights": sum(each["flights"] for each in found),
        "robot_ticks": sum(each["robot_ticks"] for each in found),
        "farthest_m": {kind: max(each["farthest_m"].get(kind, 0.0) for each in found) for kind in kinds},
        "worlds_beyond_soft_limit": sum(each > 0.0 for each in beyond),
        "worlds_beyond_margin": sum(each > RAIL_EXCURSION_M for each in beyond),
        "worlds_at_hard_limit": sum(each > RAIL_TRAVEL_M - RAIL_LIMIT_M - AT_THE_STOP_M for each in beyond),
        "stops": dict(sum((Counter(each.get("stops", {})) for each in found), Counter[str]())),
        "worst": sorted(found, key=lambda each: -each["beyond_m"])[:10],
    }


@click.command()
@click.option(
    "--ticks",
    default=100_000,
    show_default=True,
    type=click.IntRange(1),
    help="Of robots, at least; whole worlds are flown.",
)
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0))
@click.option("--through", type=click.Choice(["law", "tick"]), default="law", show_default=True)
@workers_options()
@click.option("--cost", "with_cost", is_flag=True, help="Instead: what the promise costs the shipped policies.")
@results.json_option
def main(ticks: int, seed: int, through: str, workers: Workers, with_cost: bool, json_file: Path | None) -> None:
    """Attack the safety filter; exit with 1 if the cart came farther than promised.

    \b
    Example:
      python -m validation.adversary --ticks 1000000 --seed 1
    """
    if with_cost:
        with bar("flights", len(COST_WORLDS) * len(COST_POLICIES) * FLIGHTS) as shown:
            table = cost(COST_POLICIES, lambda: shown.advance(1))
        results.report("adversary-cost", {"cost": table}, json_file)
        return
    started = time.perf_counter()
    ticks_of_a_world = (1 + GENERATIONS) * FLOWN_TICKS * ROBOTS if through == "law" else TICKS_OF_A_WORLD
    worlds = -(-ticks // ticks_of_a_world)
    seeds = {f"seed {number}": number for number in range(seed * 1_000_000, seed * 1_000_000 + worlds)}
    found = batch.run("worlds", partial(_attacked, through), seeds, workers).complete()
    figures = summed(list(found.values()))
    figures |= {"through": through, "seed": seed, "wall_s": round(time.perf_counter() - started, 1)}
    results.write(json_file, figures)
    farthest_mm, allowed_mm = 1e3 * figures["worst"][0]["beyond_m"], 1e3 * RAIL_EXCURSION_M
    click.echo(
        f"{figures['robot_ticks']} ticks in {worlds} worlds: {farthest_mm:.1f} mm beyond the soft limit at most "
        f"({allowed_mm:.0f} are allowed), {figures['worlds_beyond_margin']} worlds farther, "
        f"{figures['worlds_at_hard_limit']} at the end stop"
    )
    if figures["worlds_beyond_margin"]:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
