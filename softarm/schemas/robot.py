"""Constants of the robot: limits of the hardware and rates of the control.

Sources: [P] the CoRL 2023 paper, [C] its authors' released configuration. The arm's and the cart's parameters are a
`softarm.schemas.model.Model`, the observation's order is `softarm.schemas.policy.Observation`.
"""

from typing import Final

CONTROL_RATE_HZ: Final = 30  # rate of the tick, at which the shipped policies were trained [P]
CONTROL_PERIOD_S = 1 / CONTROL_RATE_HZ

PRESSURE_MIN_KPA, PRESSURE_MAX_KPA = -0.7, 20.0  # range of gauge pressure commands ([P] section 3.2)
CART_VELOCITY_MAX_M_S = 1.0  # largest velocity command in either direction [P]

RAIL_EXCURSION_M = 0.005  # largest overrun of the soft limit that the safety filter permits
RAIL_LIMIT_M = 0.25  # distance of the cart from the middle: limit of the task, default of the filter ([P] SM-D)
RAIL_TRAVEL_M = 0.30  # distance of the mechanical stops from the middle [P]

PHYSICS_RATE_HZ = 1200.0  # for evaluation and reference results
TRAINING_PHYSICS_RATE_HZ = 240.0  # for training, planning and fits; errors of both: docs/training/simulator.md
