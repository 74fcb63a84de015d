"""Episodes with random parameters anywhere within the registry's bounds: does any robot ever turn NaN?

python -m softarm.benchmarks.endurance            # a million episodes of 100 control steps
"""

import time
from dataclasses import dataclass

import click
import numpy as np
from rich.console import Console
from rich.progress import track

from softarm.simulator.effects import REGISTRY
from softarm.simulator.simulator import Simulator

STAGES = ("pressure", "rail", "arm", "contact")
STEPS = 100
BATCH = 4096
# Beyond this an arm has wound itself up, rad.
WILD_RAD = 5.0


@dataclass(frozen=True)
class Flights:
    """What came of a batch of episodes."""

    finite: bool
    wild: int  # robots that ended wound up


def fly(robots: int, seed: int, rate_hz: float = 240.0) -> Flights:
    """Fly one episode a robot, full-range commands every tenth of a second, a shelf within reach."""
    rng = np.random.default_rng(seed)
    simulator = Simulator(None, robots, rate_hz, overrides=draw(rng, robots))
    simulator.place_shelf(rng.uniform(-0.6, -0.25, robots), rng.uniform(0.55, 0.7, robots))
    simulator.reset(
        cart_position_m=rng.uniform(-0.025, 0.25, robots),
        joint_angles_rad=rng.uniform(-0.17, 0.17, (robots, 5)),
        pressure_kpa=rng.uniform(0.0, 20.0, robots),
    )
    for step in range(STEPS):
        if step % 3 == 0:
            velocity, pressure = rng.uniform(-1.0, 1.0, robots), rng.choice([-0.7, 20.0], robots)
        simulator.step(velocity, pressure)
    angles = simulator.link_angles_rad
    finite = bool(np.isfinite(angles).all() and np.isfinite(simulator.cart_position_m).all())
    return Flights(finite, int((np.abs(angles).max(axis=1) > WILD_RAD).sum()))


def draw(rng: np.random.Generator, robots: int) -> dict[str, np.ndarray]:
    """Return overrides: each parameter at neutral, uniform, or uniform in its magnitude, independently."""
    values = {}
    for effect in REGISTRY.values():
        for p in effect.parameters if effect.stage in STAGES else ():
            even = rng.uniform(p.low, p.high, robots)
            small = p.low + (p.high - p.low) * 10 ** rng.uniform(-4, 0, robots)
            kind = rng.integers(0, 5, robots)
            values[f"{effect.name}.{p.name}"] = np.select([kind < 2, kind < 4], [even, small], p.neutral)
    return values


@click.command()
@click.option("--episodes", default=1_000_000, show_default=True)
def main(episodes: int) -> None:
    """Fly episodes and say how many ended in NaN or wound up."""
    start, flights = time.perf_counter(), []
    for seed in track(range(-(-episodes // BATCH)), transient=True):
        flights.append(fly(BATCH, seed))
    broken, wild = sum(not each.finite for each in flights), sum(each.wild for each in flights)
    Console(soft_wrap=True).print(
        f"{len(flights) * BATCH:,} episodes in {time.perf_counter() - start:.0f} s: "
        f"{broken} batches with NaN, {wild} arms wound up"
    )
    raise SystemExit(broken > 0)


if __name__ == "__main__":
    main()
