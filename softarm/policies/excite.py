"""Policy that plays an excitation in open loop, for recordings from which the robot is identified."""

import math

import numpy as np

from softarm.common.words import nearest
from softarm.policies.base import Array, PolicyError, PolicySpec
from softarm.schemas.excitation import EXCITATIONS
from softarm.schemas.policy import places
from softarm.schemas.robot import CONTROL_RATE_HZ

LEAD_IN_S = 4.0  # time in which the cart moves to the middle and the arm comes to rest
_APPROACH_PER_S, _APPROACH_MAX_M_S = 2.0, 0.15
[_CART] = places("cart_position_m")


class Excite:
    """Excitation after a lead-in, followed by rest; a goal of kind `run` starts it.

    `excitation` is a name of schemas.excitation.EXCITATIONS. Raises PolicyError for another name.
    """

    spec = PolicySpec(name="excite", description="plays an excitation", needs_target=False)

    def __init__(self, excitation: str = "seed") -> None:
        self.spec = self.describe(excitation)
        self._excitation = EXCITATIONS[excitation]
        self._step = 0

    @classmethod
    def describe(cls, excitation: str = "seed") -> PolicySpec:
        """Return the spec of an excitation, with its number of steps, without creating the policy."""
        if excitation not in EXCITATIONS:
            near = nearest(excitation, EXCITATIONS)
            hint = f"; did you mean {near}?" if near else ""
            raise PolicyError(f"no excitation {excitation!r}{hint} (there are: {', '.join(EXCITATIONS)})")
        chosen = EXCITATIONS[excitation]
        steps = math.ceil((LEAD_IN_S + chosen.duration_s) * CONTROL_RATE_HZ)
        return PolicySpec(
            "excite", f"plays {chosen.name}: {chosen.description}", needs_target=False, episode_steps=steps
        )

    def reset(self) -> None:
        """Start again with the lead-in."""
        self._step = 0

    def step(self, observation: Array, goal: Array) -> Array:
        """Return the next command; only the lead-in uses the observation (the cart position)."""
        t_s = self._step / CONTROL_RATE_HZ - LEAD_IN_S
        self._step += 1
        if t_s >= 0:
            return np.array(self._excitation.at(t_s), dtype=np.float32)
        if not self._excitation.moves_rail:
            return np.zeros(2, dtype=np.float32)
        # The cart rests in the last second, so that the arm stops swinging.
        approach = -_APPROACH_PER_S * float(observation[_CART]) if t_s < -1.0 else 0.0
        return np.array((max(-_APPROACH_MAX_M_S, min(_APPROACH_MAX_M_S, approach)), 0.0), dtype=np.float32)
