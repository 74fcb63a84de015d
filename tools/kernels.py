"""Compile the simulator's kernels, so that tests that start together do not each compile them.

Example: python -m tools.kernels
"""

from concurrent.futures import ProcessPoolExecutor
from itertools import product
from typing import Any

import numpy as np

from softarm.simulator.simulator import NARROW, PARALLEL_BLOCKS, WIDE
from softarm.simulator.stage_simulator import StageSimulator

# One SIMD register, a batch on one core, a batch on all cores.
ROBOTS = (len(NARROW), len(WIDE), len(WIDE) * PARALLEL_BLOCKS)
# The paper's model, which leaves every effect out, and a model with one.
OVERRIDES: tuple[dict[str, float], ...] = ({}, {"arm.payload.mass": 0.01})
# The reference of the simulator's tests steps a few robots in double precision.
KINDS = (*product(ROBOTS, (np.float32,)), (ROBOTS[0], np.float64))


def compile_for(kind: tuple[int, Any], overrides: dict[str, float]) -> None:
    """Run every entry point of the kernel once for a batch of this size and precision."""
    robots, dtype = kind
    simulator = StageSimulator(robots=robots, overrides=overrides, dtype=dtype)
    simulator.step(0.0, 0.0)
    simulator.tip_m()
    if robots > len(WIDE) or dtype is np.float64:
        return
    zeros = np.zeros((1, robots))
    simulator.fly(zeros, zeros)
    simulator.fly_pressure(zeros, zeros, 0.01)
    simulator.fly_cart(zeros, zeros, zeros, 0.01)
    simulator.fly_arm(zeros, zeros, zeros, 0.01)


if __name__ == "__main__":
    with ProcessPoolExecutor() as processes:
        list(processes.map(compile_for, *zip(*product(KINDS, OVERRIDES), strict=True)))
