"""The held-back robots: independent ones of `reality/`, which no simulator of ours was made from.

All but the nominal one differ from what every policy but a robust one was trained for.
"""

from softarm.reality.parameters import Arm, Rail, Regulator, RobotParameters
from softarm.simulator.effects import exemplars

# As strong as the registry's examples: 50 g at the tip, a regulator that takes half as long again, a drive that hears
# half a tick later.
_STRONG = exemplars()
PAYLOAD = Arm(payload_kg=_STRONG["arm.payload"]["mass"])
SLOW = Regulator(inflate_s=_STRONG["pressure.lag"]["inflate"], deflate_s=_STRONG["pressure.lag"]["deflate"])
LATE = Rail(delay_s=_STRONG["rail.delay"]["delay"])
ROBOTS = {
    "nominal": RobotParameters(),
    "payload": RobotParameters(arm=PAYLOAD),
    "slow": RobotParameters(regulator=SLOW),
    "late": RobotParameters(rail=LATE),
    "changed": RobotParameters(arm=PAYLOAD, regulator=SLOW, rail=LATE),
    # Further off, and where it hurts: a swing is timed by the cart.
    "later": RobotParameters(rail=Rail(delay_s=0.09)),
    "weak": RobotParameters(rail=Rail(acceleration_m_s2=3.0)),
}
