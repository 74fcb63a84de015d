"""Data model of a model file: the robot's parameters and the simulator's effects.

Frame: planar, y along the rail, z up, metres. Positive pressure bends the arm towards negative y. Joint angle
i is link i against link i-1, positive towards +y; 0 hangs straight down. Pressure is gauge, kPa.
Sources: [P] the CoRL 2023 paper, [C] its authors' released configuration.
"""

import math
from typing import Annotated, Self

from pydantic import Field, model_validator

from softarm.common.quantity import KPA_PER_PSI
from softarm.schemas.base import Strict
from softarm.schemas.robot import CONTROL_PERIOD_S, RAIL_TRAVEL_M

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]


class Arm(Strict):
    """The n-link arm that models the inflated beam ([P] section 3.1; every default: [C], [P] SM-B)."""

    link_length_m: tuple[Positive, ...] = (0.0885,) * 5
    link_mass_kg: tuple[Positive, ...] = (0.005, 0.005, 0.005, 0.005, 0.1)
    # About each link's centre, around the bending axis; the centre of mass is at half length.
    link_inertia_kg_m2: tuple[Positive, ...] = (6.89e-6,) * 4 + (1.0156e-4,)
    stiffness_nm_rad: tuple[NonNegative, ...] = (0.8385, 1.5400, 1.5109, 1.2887, 0.4347)
    damping_nm_s_rad: tuple[NonNegative, ...] = (0.0178, 0.0304, 0.0528, 0.0367, 0.0223)
    muscle_gain_nm_kpa: tuple[float, ...] = tuple(b / KPA_PER_PSI for b in (0.0247, 0.0616, 0.0779, 0.0498, 0.0268))
    # A constant torque towards -y; [C] only, the paper leaves it out.
    torque_offset_nm: tuple[float, ...] = (0.0007, 0.0062, 0.0402, 0.0160, 0.0133)
    base_height_m: float = 0.965
    gravity_m_s2: float = 9.81

    @model_validator(mode="after")
    def _check_lengths(self) -> Self:
        n = len(self.link_length_m)
        for name, value in self:
            if isinstance(value, tuple) and len(value) != n:
                raise ValueError(f"{name} has {len(value)} entries, link_length_m has {n}: give one entry a link")
        if not 1 <= n <= 12:
            raise ValueError(f"link_length_m has {n} entries; the simulator takes 1 to 12 links")
        return self

    @property
    def links(self) -> int:
        """Return the number of links."""
        return len(self.link_length_m)


class Cart(Strict):
    """The cart and the drive's force law ([P] section 3.3, gains in [P] SM-E and [C])."""

    mass_kg: Positive = 0.4
    # Feed-forward of the acceleration tracker: [C] uses 0.5 where the paper says "the mass of the robot".
    feedforward_mass_kg: NonNegative = 0.5
    acceleration_gain_kg: NonNegative = 0.30
    velocity_gain_n_s_m: NonNegative = 30.0
    tracking_switch_m_s: NonNegative = 0.1
    travel_m: Positive = RAIL_TRAVEL_M  # mechanical stops at +-travel_m


# An effect's parameters by name, each in the unit that the registry says (simulator/effects.py); inf is allowed: the
# neutral value of some.
EffectValues = dict[str, Annotated[float, Field(allow_inf_nan=True)]]


def seed_effects() -> dict[str, dict[str, float]]:
    """Return the four effects of the seed's simulator, which Table 1 of the paper removes one by one."""
    return {
        # [C] filters once per 30 Hz step and keeps 0.81 (inflating) and 0.86 (deflating) of the old pressure.
        "pressure.lag": {"inflate": -CONTROL_PERIOD_S / math.log(0.81), "deflate": -CONTROL_PERIOD_S / math.log(0.86)},
        "rail.acceleration_limit": {"acceleration": 6.0},  # m/s^2 [P]
        "rail.delay": {"delay": CONTROL_PERIOD_S},  # one control step [P]
        "observation.finite_difference": {},
    }


class Model(Strict):
    """A model file: the robot's parameters and the simulator's effects; by default the seed's simulator.

    `effects` maps the name of an effect to its parameters; the simulator lacks an effect that is absent. Names, units
    and bounds are the registry's: the simulator checks them with `softarm.simulator.effects.validate`.
    """

    arm: Arm = Arm()
    cart: Cart = Cart()
    effects: dict[str, EffectValues] = Field(default_factory=seed_effects)
