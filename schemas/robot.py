"""The robot's facts, each once: what the hardware can do and what the seed's control counts on.

Sources: [P] the CoRL 2023 paper, [C] its authors' released configuration. The arm's and the cart's parameters are a
`softarm.schemas.model.Model`, the observation's order is `softarm.schemas.policy.Observation`.
"""

from typing import Final

CONTROL_RATE_HZ: Final = 30  # of the tick; the shipped policies were trained at it [P]
CONTROL_PERIOD_S = 1 / CONTROL_RATE_HZ

PRESSURE_MIN_KPA, PRESSURE_MAX_KPA = -0.7, 20.0  # gauge; what may be commanded ([P] section 3.2)
CART_VELOCITY_MAX_M_S = 1.0  # either way; what may be commanded [P]

RAIL_EXCURSION_M = 0.005  # beyond the soft limit: no farther, the safety filter promises, on a robot as configured
RAIL_LIMIT_M = 0.25  # of the cart from the middle: the task's, and the safety filter's default ([P] SM-D)
RAIL_TRAVEL_M = 0.30  # the mechanical stops [P]

PHYSICS_RATE_HZ = 1200.0  # the seed's: for evaluation and whatever must be right
TRAINING_PHYSICS_RATE_HZ = 240.0  # for training, planning and fits: docs/simulator.md gives the errors of both
