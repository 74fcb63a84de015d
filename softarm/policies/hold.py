"""Policy that stands still, used between goals."""

import numpy as np

from softarm.policies.base import Array, PolicyError, PolicySpec
from softarm.schemas.policy import ACTION


class Hold:
    """Policy with zero cart velocity and a constant gauge pressure.

    Raises PolicyError for a pressure outside the muscle's command range.
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
        """Do nothing: the policy has no state."""

    def step(self, observation: Array, goal: Array) -> Array:
        """Return [0 m/s, rest pressure] for any observation and goal."""
        return self._action
