"""Stand still: what the arm does between goals."""

import numpy as np

from softarm.policies.base import Array, PolicyError, PolicySpec
from softarm.schemas.policy import ACTION


class Hold:
    """Zero cart velocity and a constant pressure.

    rest_pressure_kpa: gauge, within the muscle's command range. Raises PolicyError outside it.
    """

    spec = PolicySpec(name="hold", description="cart at rest, muscle at its rest pressure", needs_target=False)

    def __init__(self, rest_pressure_kpa: float = 0.0) -> None:
        low, high = ACTION[1].low, ACTION[1].high
        if low is None or high is None or not low <= rest_pressure_kpa <= high:
            raise PolicyError(
                f"option rest_pressure_kpa is {rest_pressure_kpa}; allowed {low} to {high} kPa: "
                "choose a pressure in that range or leave the option out for 0 kPa"
            )
        self._action = np.array([0.0, rest_pressure_kpa], dtype=np.float32)

    def reset(self) -> None:
        """Nothing to forget."""

    def step(self, observation: Array, goal: Array) -> Array:
        """Return [0 m/s, rest pressure]; neither the observation nor the goal matters."""
        return self._action
