"""Simulate episodes with random parameters within the registry's bounds: does any robot ever become NaN?

python -m validation.endurance --json FILE      a million episodes of 100 control steps
"""

import time
from pathlib import Path

import click
import numpy as np

from benchmarks import results
from softarm.common.processes import bar
from softarm.schemas.robot import PRESSURE_MAX_KPA, PRESSURE_MIN_KPA, RAIL_LIMIT_M, TRAINING_PHYSICS_RATE_HZ
from softarm.simulator.effects import REGISTRY
from softarm.simulator.simulator import Simulator

STAGES = ("pressure", "rail", "arm", "contact")
STEPS = 100
BATCH = 4096
# Joint angle beyond which an arm counts as coiled up, rad.
COILED_RAD = 5.0


def fly(robots: int, seed: int, rate_hz: float = TRAINING_PHYSICS_RATE_HZ) -> tuple[bool, int]:
    """Simulate one episode per robot, with full-range commands every tenth of a second and a shelf within reach.

    Returns:
        Whether all robots stayed finite, and how many ended coiled up.
    """
    rng = np.random.default_rng(seed)
    simulator = Simulator(None, robots, rate_hz, overrides=draw(rng, robots))
    simulator.place_shelf(rng.uniform(-0.6, -0.25, robots), rng.uniform(0.55, 0.7, robots))
    simulator.reset(
        cart_position_m=rng.uniform(-0.025, RAIL_LIMIT_M, robots),
        joint_angles_rad=rng.uniform(-0.17, 0.17, (robots, 5)),
        pressure_kpa=rng.uniform(0.0, PRESSURE_MAX_KPA, robots),
    )
    for step in range(STEPS):
        if step % 3 == 0:
            velocity = rng.uniform(-1.0, 1.0, robots)
            pressure = rng.choice([PRESSURE_MIN_KPA, PRESSURE_MAX_KPA], robots)
        simulator.step(velocity, pressure)
    angles = simulator.link_angles_rad
    finite = bool(np.isfinite(angles).all() and np.isfinite(simulator.cart_position_m).all())
    return finite, int((np.abs(angles).max(axis=1) > COILED_RAD).sum())


def draw(rng: np.random.Generator, robots: int) -> dict[str, np.ndarray]:
    """Return overrides with each parameter independently at neutral, uniform, or uniform in its magnitude."""
    values = {}
    for effect in REGISTRY.values():
        for p in effect.parameters if effect.stage in STAGES else ():
            even = rng.uniform(p.low, p.high, robots)
            small = p.low + (p.high - p.low) * 10 ** rng.uniform(-4, 0, robots)
            kind = rng.integers(0, 5, robots)
            values[f"{effect.name}.{p.name}"] = np.select([kind < 2, kind < 4], [even, small], p.neutral)
    return values


@click.command()
@click.option("--episodes", default=1_000_000, show_default=True, type=click.IntRange(min=1))
@results.json_option
def main(episodes: int, json_file: Path | None) -> None:
    """Simulate episodes and count those that became NaN or coiled up; exit with 1 if one is NaN.

    \b
    Example:
      python -m validation.endurance --episodes 100000
    """
    start = time.perf_counter()
    batches, count = [], -(-episodes // BATCH)
    with bar("flying", count) as shown:
        for seed in range(count):
            batches.append(fly(BATCH, seed))
            shown.advance()
    figures = {
        "episodes": len(batches) * BATCH,
        "seconds": time.perf_counter() - start,
        "batches_with_nan": sum(not finite for finite, _ in batches),
        "coiled_up": sum(coiled for _, coiled in batches),
    }
    results.write(json_file, figures)
    click.echo(
        f"{figures['episodes']:,} episodes in {figures['seconds']:.0f} s: "
        f"{figures['batches_with_nan']} batches with NaN, {figures['coiled_up']} arms coiled up"
    )
    raise SystemExit(figures["batches_with_nan"] > 0)


if __name__ == "__main__":
    main()
