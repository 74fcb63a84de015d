"""Compile the simulator's kernels, so that tests that start together do not each compile them.

Example: python -m tools.kernels
"""

from concurrent.futures import ProcessPoolExecutor
from itertools import product

import numpy as np

from softarm.simulator.simulator import NARROW, PARALLEL_BLOCKS, WIDE
from softarm.simulator.stage_simulator import StageSimulator

# One SIMD register, a batch on one core, a batch on all cores.
ROBOTS = (len(NARROW), len(WIDE), len(WIDE) * PARALLEL_BLOCKS)
# The paper's model, which leaves every effect out, and a model with one.
OVERRIDES: tuple[dict[str, float], ...] = ({}, {"arm.payload.mass": 0.01})


def compile_for(robots: int, overrides: dict[str, float]) -> None:
    """Run every entry point of the kernel once for a batch of this size."""
    simulator = StageSimulator(robots=robots, overrides=overrides)
    simulator.step(0.0, 0.0)
    if robots > len(WIDE):
        return
    zeros = np.zeros((1, robots))
    simulator.fly(zeros, zeros)
    simulator.fly_pressure(zeros, zeros, 0.01)
    simulator.fly_cart(zeros, zeros, zeros, 0.01)
    simulator.fly_arm(zeros, zeros, zeros, 0.01)


if __name__ == "__main__":
    with ProcessPoolExecutor() as processes:
        list(processes.map(compile_for, *zip(*product(ROBOTS, OVERRIDES), strict=True)))
