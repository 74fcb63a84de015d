"""The policy `pump`: swing the arm up as a child on a swing does, with the end of the swing at the target."""

import math

import numpy as np
from softarm.policies.base import Array, PolicyError, PolicySpec
from softarm.schemas.model import Model
from softarm.schemas.policy import ACTION, Observation
from softarm.schemas.robot import RAIL_LIMIT_M

_ARM = Model().arm
_LENGTH_M, _HEIGHT_M = sum(_ARM.link_length_m), _ARM.base_height_m
_SPEED_M_S, _PRESSURE_KPA = ((signal.low, signal.high) for signal in ACTION)


class Pump:
    """Policy that amplifies the swing until it is as high as the target, then keeps the cart in place.

    Args:
        pump_per_s: Cart velocity against each metre of the tip's deflection, which amplifies the swing.
        place_per_s: Cart velocity for each metre to the place from which the target is the end of the swing.
        lead_s: Delay of a command.

    Raises:
        PolicyError: A number is negative, NaN or infinity.
    """

    interface = 1
    spec = PolicySpec(name="pump", description="amplifies the swing until its end is the target; without learning")

    def __init__(self, pump_per_s: float = 6.0, place_per_s: float = 1.5, lead_s: float = 0.1) -> None:
        for name, value in (("pump_per_s", pump_per_s), ("place_per_s", place_per_s), ("lead_s", lead_s)):
            if not (math.isfinite(value) and value >= 0):
                raise PolicyError(f"option {name} is {value}; allowed: 0 or more")
        self.pump_per_s, self.place_per_s, self.lead_s = pump_per_s, place_per_s, lead_s

    def reset(self) -> None:
        """Do nothing: the policy has no state."""

    def step(self, observation: Array, goal: Array) -> Array:
        """Return [cart velocity (m/s), pressure (kPa)]."""
        seen = Observation(*map(float, observation))
        y_m, z_m = map(float, goal)
        side, reach_m = self._reach(y_m, z_m)
        away_m = seen.tip_y_m - seen.cart_position_m
        soon_m = away_m + self.lead_s * (seen.tip_vy_m_s - seen.cart_velocity_m_s)
        lacking = max(reach_m - abs(away_m), 0.0) / max(reach_m, 0.05)
        place_m = np.clip(y_m - side * reach_m, -RAIL_LIMIT_M + 0.03, RAIL_LIMIT_M - 0.03)
        velocity = -self.pump_per_s * lacking * soon_m + self.place_per_s * (place_m - seen.cart_position_m)
        # Pressure bends the arm towards -y and helps on the way there.
        helps = side < 0 and seen.tip_vy_m_s < seen.cart_velocity_m_s
        pressure = _PRESSURE_KPA[1] if helps else 0.0
        return np.array([np.clip(velocity, *_SPEED_M_S), pressure], dtype=np.float32)

    def _reach(self, y_m: float, z_m: float) -> tuple[float, float]:
        """Return the side of the cart and the distance, m, of a target at the height of the swing."""
        drop_m = min(max(_HEIGHT_M - z_m, 0.0), _LENGTH_M)
        reach_m = math.sqrt(_LENGTH_M**2 - drop_m**2)
        return (-1.0 if y_m < 0.05 else 1.0), reach_m
