"""Random commands for 3 s at 30 Hz, equal in every comparison."""

import numpy as np

from softarm.schemas.robot import CONTROL_PERIOD_S, PRESSURE_MAX_KPA, PRESSURE_MIN_KPA

STEPS = 90


def smooth(robots: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return sums of three sinusoids in the command range: cart velocity (m/s), pressure (kPa), each [STEPS, R]."""
    rng = np.random.default_rng(seed)
    t = np.arange(STEPS)[:, None] * CONTROL_PERIOD_S

    def wave() -> np.ndarray:
        total = sum(
            rng.uniform(0.2, 1.0, robots)
            * np.sin(2 * np.pi * rng.uniform(0.2, 2.0, robots) * t + rng.uniform(0, 2 * np.pi, robots))
            for _ in range(3)
        )
        return np.asarray(total / np.abs(total).max(axis=0))

    return wave(), 9.65 + 10.35 * wave()


def bang_bang(robots: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return full-range switching with a new draw every 0.1 s; shapes as `smooth`."""
    rng = np.random.default_rng(seed)
    draws = rng.integers(0, 2, (2, STEPS // 3, robots)).repeat(3, axis=1)
    return 2.0 * draws[0] - 1.0, np.where(draws[1] == 1, PRESSURE_MAX_KPA, PRESSURE_MIN_KPA)
